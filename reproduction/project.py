"""Where the project's files are, and which notebooks a command is about."""

from __future__ import annotations

from pathlib import Path

NOTEBOOKS, FIGURES, LEDGER = Path("notebooks"), Path("figures"), Path("reproduction") / "ledger"
LESSONS = NOTEBOOKS / "lessons"


class CommandError(Exception):
    """A failure in words for the terminal."""


def project() -> Path:
    """Return the project's root, seen from there, from its notebooks/ or from notebooks/lessons/.

    Raises FileNotFoundError elsewhere.
    """
    here = Path.cwd()
    root = next((each.parent for each in (here, *here.parents[:2]) if each.name == NOTEBOOKS.name), here)
    if not any(root.glob(f"{NOTEBOOKS}/*.ipynb")):
        raise FileNotFoundError(f"{here}: needs the project's root or its notebooks/, with notebooks in it")
    return root


def chosen(some: list[str], known: list[str]) -> list[str]:
    """Return the given keys, or all known keys if none is given. Raises CommandError for an unknown one."""
    for key in some:
        if key not in known:
            raise CommandError(f"unknown notebook {key!r}; the known ones are {', '.join(known)}")
    return list(dict.fromkeys(some)) or known  # each once


def chosen_notebooks(root: Path, some: list[str]) -> dict[str, Path]:
    """Return {key: path} of the given notebooks of the project, or of all if none is given.

    The key of a paper's notebook is its name, that of a lesson its name behind "lessons/".
    """
    found = [path for folder in (NOTEBOOKS, LESSONS) for path in sorted(root.glob(f"{folder}/*.ipynb"))]
    paths = {path.relative_to(root / NOTEBOOKS).with_suffix("").as_posix(): path for path in found}
    return {key: paths[key] for key in chosen(some, list(paths))}
