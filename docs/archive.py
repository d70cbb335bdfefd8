"""The source as an archive to download: the committed tree, the same bytes wherever it is made.

In an archive that was unpacked there is no git: then the tree is what lies there, without what .gitignore names. Both
give the same bytes, since times, owners and the order of the files are fixed.
"""

import gzip
import io
import os
import subprocess
import tarfile
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path


def committed(root):
    """Return {path: (bytes, executable)} of the last commit, or None where root is no git repository of its own."""

    def git(*arguments):
        return subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, check=True).stdout

    try:
        if Path(git("rev-parse", "--show-toplevel").decode().strip()).resolve() != Path(root).resolve():
            return None
        packed = git("archive", "--format=tar", "HEAD")
    except (OSError, subprocess.CalledProcessError):
        return None
    with tarfile.open(fileobj=io.BytesIO(packed)) as tar:
        files = [each for each in tar.getmembers() if each.isfile()]
        return {each.name: (tar.extractfile(each).read(), bool(each.mode & 0o100)) for each in files}


def lying_there(root):
    """Return {path: (bytes, executable)} of the files below root that .gitignore does not name."""
    root = Path(root)
    names = root / ".gitignore"
    lines = names.read_text(encoding="utf-8").split() if names.is_file() else []
    ignored = [".git", "__pycache__", "docs/_build", *(line.rstrip("/") for line in lines)]

    def leaves_out(path):
        return any(fnmatch(path.name, each) or path.relative_to(root).as_posix() == each for each in ignored)

    found = {}
    folders = [root]
    while folders:
        for path in folders.pop().iterdir():
            if leaves_out(path):
                continue
            if path.is_dir():
                folders.append(path)
            else:
                found[path.relative_to(root).as_posix()] = path.read_bytes(), os.access(path, os.X_OK)
    return found


def packed(files, name, day):
    """Return files, {path: (bytes, executable)}, as a .tar.gz whose folder is `name`; all were changed on that day.

    >>> made = packed({"b": (b"2", False), "a": (b"1", True)}, "x-1", "2026-01-01")
    >>> with tarfile.open(fileobj=io.BytesIO(made)) as tar:
    ...     print([(each.name, oct(each.mode)) for each in tar])
    [('x-1/a', '0o755'), ('x-1/b', '0o644')]
    """
    changed = int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp())
    tape = io.BytesIO()
    with tarfile.open(fileobj=tape, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for path, (data, executable) in sorted(files.items()):
            entry = tarfile.TarInfo(f"{name}/{path}")
            entry.size, entry.mtime, entry.mode = len(data), changed, 0o755 if executable else 0o644
            tar.addfile(entry, io.BytesIO(data))
    return gzip.compress(tape.getvalue(), mtime=0)


def source(root, name, day):
    """Return the project's source as a .tar.gz."""
    return packed(committed(root) or lying_there(root), name, day)
