"""The ledger: what the papers print, and whether it holds. It knows no filter.

`items`: what a paper prints; `verdicts`: whether it holds; `paper`: what compares the two; `shown`, `tables` and
`contents`: what a notebook shows of it; `files`: where all of it is stored.
"""

from .files import keys, published, read_paper, shipped_verdicts, stored_verdicts
from .items import About, Cause, Item
from .paper import Paper
from .tables import Table, cell_text, gap_text
from .verdicts import Verdict, Verdicts

__all__ = [
    "About",
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
