"""Files are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path


def write_whole(path: Path, data: bytes) -> None:
    """Write bytes beside the file and move them into its place: an interrupt leaves the old file as it was."""
    write_together({path: data})


def write_together(contents: dict[Path, bytes]) -> None:
    """Write bytes to several files, {path: bytes}: beside them first, then all into their places.

    A full disk or an interrupt during the writing leaves every file as it was. An interrupt during the moves
    (microseconds) may leave some files new and others old, but none partial.
    """
    parts = {path: path.with_name(path.name + ".part") for path in contents}
    for path in contents:
        if path.is_dir():
            raise IsADirectoryError(f"a folder is in the place of the file {path}")
    try:
        for path, part in parts.items():
            try:
                part.write_bytes(contents[path])
            except OSError as error:
                # A full disk is reported without the file's name.
                raise OSError(error.errno, error.strerror, str(path)) from None
        for path, part in parts.items():
            os.replace(part, path)
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
