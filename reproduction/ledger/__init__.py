"""The ledger: what the papers print, and whether it holds. It knows no filter."""

from .paper import Cause, Item, Paper, keys, published, read_paper, shipped_verdicts, stored_verdicts
from .tables import Table, cell_text, gap_text
from .verdicts import Verdict, Verdicts

__all__ = [
    "Cause",
    "Item",
    "Paper",
    "Table",
    "Verdict",
    "Verdicts",
    "cell_text",
    "gap_text",
    "keys",
    "published",
    "read_paper",
    "shipped_verdicts",
    "stored_verdicts",
]
