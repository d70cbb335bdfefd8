"""Where the project's files are, and which notebooks a command is about."""

from __future__ import annotations

from pathlib import Path

NOTEBOOKS, FIGURES, LEDGER = Path("notebooks"), Path("figures"), Path("reproduction") / "ledger"


class CommandError(Exception):
    """A failure in words for the terminal."""


def project() -> Path:
    """Return the project's root, seen from there or from its notebooks/. Raises FileNotFoundError elsewhere."""
    here = Path.cwd()
    root = here.parent if here.name == "notebooks" else here
    if not any(root.glob("notebooks/*.ipynb")):
        raise FileNotFoundError(f"{here}: needs the project's root or its notebooks/, with notebooks in it")
    return root


def chosen(some: list[str], known: list[str]) -> list[str]:
    """Return the given keys, or all known keys if none is given. Raises CommandError for an unknown one."""
    for key in some:
        if key not in known:
            raise CommandError(f"unknown notebook {key!r}; the known ones are {', '.join(known)}")
    return list(dict.fromkeys(some)) or known  # each once


def chosen_notebooks(root: Path, some: list[str]) -> dict[str, Path]:
    """Return {key: path} of the given notebooks of the project, or of all if none is given."""
    paths = {path.stem: path for path in sorted(root.glob(f"{NOTEBOOKS}/*.ipynb"))}
    return {key: paths[key] for key in chosen(some, list(paths))}
