"""Four papers, reproduced: what they print and whether it holds, their experiments and their drawings.

It imports `mpt_helpers`, the filters, and is imported by notebooks, site and tests only; it is not installed with them.

- `ledger`: what the papers print, one TOML each, and the verdicts; it knows no filter;
- `paper_2007`, `papers_2014_2015`, `paper_2016`: experiments, figures, and the drawings of the lessons;
- `burden`: operation counts of the filters, which three of the papers give;
- `figures`: figures that are saved, and described in words; `project`: where the files are;
- `runner`: the notebooks run side by side, and what comes of it in the end; `execute`: one of them, in its process;
- `__main__`: `python -m reproduction` reproduce, verdicts, readme, tidy.
"""

from .ledger import Table, gap_text, published

__all__ = ["Table", "gap_text", "published"]
