"""Files are written whole or not at all."""

import os
from pathlib import Path


def write_whole(path, data):
    """Write bytes beside the file and move them into its place: an interrupt leaves the old file as it was."""
    path = Path(path)
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(data)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
