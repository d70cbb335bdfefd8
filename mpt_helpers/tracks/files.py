"""Writing files: whole or not at all, and none replaced unless asked."""

from __future__ import annotations

import os
import secrets
from pathlib import Path


def write_whole(path: Path, data: bytes) -> None:
    """Write bytes beside the file and move them into its place: an interrupt leaves the old file as it was."""
    write_together({path: data})


def write_together(contents: dict[Path, bytes], overwrite: bool = True, source: Path | str | None = None) -> None:
    """Write bytes to several files, {path: bytes}: beside them first, then all into their places.

    A full disk or an interrupt during the writing leaves every file as it was. An interrupt during the moves
    (microseconds) may leave some files new and others old, but none partial. Raises FileExistsError as
    `require_free`, before anything is written.
    """
    require_free(list(contents), overwrite, source)
    parts = {path: path.with_name(f".{secrets.token_hex(8)}.part") for path in contents}
    try:
        for path, part in parts.items():
            try:
                with part.open("xb") as file:
                    file.write(contents[path])
            except OSError as error:  # a full disk is reported without the file's name
                raise OSError(error.errno, error.strerror, str(path)) from None
        for path, part in parts.items():
            os.replace(part, path)
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)


def require_free(paths: list[Path], overwrite: bool, source: Path | str | None) -> None:
    """Raise FileExistsError for the source, a pipe or device, an existing file unless `overwrite`; refuse folders."""
    for path in paths:
        if path.is_dir():
            raise IsADirectoryError(f"a folder is in the place of the file {path}")
        if path.exists() and not path.is_file():
            raise FileExistsError(f"{path}: is a pipe or a device, not a file")
        if isinstance(source, Path) and path.exists() and source.exists() and path.samefile(source):
            raise FileExistsError(f"{path}: is the recording itself, which is never overwritten")
        if not overwrite and (path.exists() or path.is_symlink()):
            raise FileExistsError(f"{path}: exists; to replace it give overwrite=True, in the command --overwrite")
