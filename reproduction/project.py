"""Where the project's files are."""

from __future__ import annotations

from pathlib import Path


def project() -> Path:
    """Return the project's root, seen from there or from its notebooks/. Raises FileNotFoundError elsewhere."""
    here = Path.cwd()
    root = here.parent if here.name == "notebooks" else here
    if not any(root.glob("notebooks/*.ipynb")):
        raise FileNotFoundError(f"{here}: needs the project's root or its notebooks/, with notebooks in it")
    return root
