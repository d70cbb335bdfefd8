"""The page on speed: the answer and the ratios first, from benchmarks/results.json."""

import json
import math
from pathlib import Path

from reproduction.ledger.tables import Table

RESULTS = Path(__file__).parents[1] / "benchmarks" / "results.json"
PAIRS = {
    "kf-lf-a": "Kalman A, against Lainiotis A",
    "kf-lf-b": "Kalman B, against Lainiotis B",
    "kf-a-sskf-b": "steady state B, against Kalman A",
    "lf-a-sslf-b": "steady state B, against Lainiotis A",
}


def results():
    """Return the stored measurements."""
    return json.loads(RESULTS.read_text(encoding="utf-8"))


def number(value):
    """Return a number as text of three digits.

    >>> number(5621.2), number(0.98), number(6.7243)
    ('5,621', '0.98', '6.72')
    """
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def times_as_fast(row):
    """Return how many times as fast as its peer a row is; a ratio below 1 is slower.

    The stored ratio is the median over the rounds, in the direction of the row's goal; the median times tell which.

    >>> times_as_fast({"ms": 10, "against_ms": 30, "ratio": 3.1})
    3.1
    >>> times_as_fast({"ms": 30, "against_ms": 10, "ratio": 4})
    0.25
    """
    if not row.get("against_ms"):
        return row["ratio"]
    faster = row["against_ms"] / row["ms"]
    same_way = abs(math.log(row["ratio"] / faster)) <= abs(math.log(row["ratio"] * faster))
    return row["ratio"] if same_way else 1 / row["ratio"]


def in_words(times):
    """Return a speed in words.

    >>> print(in_words(183.1), in_words(0.5), sep=", ")
    183× as fast, 2× as long
    """
    return f"{number(times)}× as fast" if times >= 1 else f"{number(1 / times)}× as long"


def answer(rows):
    """Return the answer in a sentence: the Kalman filter of the most tracks beside all that it was compared with."""
    most = max(each.get("tracks") or 1 for each in rows)
    beside = [each for each in rows if each["work"] == "Kalman" and each.get("tracks") == most]
    compared = ", ".join(f"{in_words(times_as_fast(each))} as {each['against']}" for each in beside)
    return f"The Kalman filter over {most:,} tracks of 1,000 steps takes {beside[0]['ms']:.0f} ms: {compared}."


def tables(rows):
    """Return the measurements as tables in Markdown, [(how many tracks, table)], the ratio first."""
    made = []
    for tracks in dict.fromkeys(each.get("tracks") for each in rows):
        own = [each for each in rows if each.get("tracks") == tracks]
        lines = [
            [
                each["work"],
                in_words(times_as_fast(each)).replace(" ", "\N{NO-BREAK SPACE}"),
                each["against"],
                number(each["ms"]) if each.get("ms") else "",
            ]
            for each in own
        ]
        made.append((tracks, Table(["what", "ratio", "beside", "ms"], lines).markdown()))
    return made


def three_axes(rows):
    """Return the ways to run a filter for three axes as a table in Markdown: operations, and ratios to the first."""
    lines = []
    for each in rows:
        times = [f"{each[kind]:.2g}" if kind in each else "" for kind in ("one", "many")]
        lines.append([each["name"], f"{each['operations']:,}", *times])
    return Table(["one step for three axes", "operations", "time, one phone", "time, many phones"], lines).markdown()


def clock(speedups):
    """Return the papers' speedups on the clock as a table in Markdown."""
    lines = [
        [paper[:4], PAIRS[pair], *(number(values[kind]) for kind in ("one", "own", "shared"))]
        for paper, pairs in speedups.items()
        for pair, values in pairs.items()
    ]
    return Table(["paper", "how many times as fast", "one track", "many", "many, shared"], lines).markdown()
