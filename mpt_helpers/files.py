"""Files are written whole or not at all."""

import os


def write_whole(path, data):
    """Write bytes beside the file and move them into its place: an interrupt leaves the old file as it was."""
    write_together({path: data})


def write_together(contents):
    """Write bytes to several files, {path: bytes}: beside them first, then all into their places.

    A full disk or an interrupt leaves every file as it was while they are written. What stops the moves, some
    microseconds in all, leaves some files new and some old, each whole.
    """
    parts = {path: path.with_name(path.name + ".part") for path in contents}
    for path in contents:
        if path.is_dir():
            raise IsADirectoryError(f"a folder is in the place of the file {path}")
    try:
        for path, part in parts.items():
            part.write_bytes(contents[path])
        for path, part in parts.items():
            os.replace(part, path)
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
