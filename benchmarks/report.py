"""The tables of README.md, from results.json."""

import json
from pathlib import Path

from mpt_helpers.tracks.files import write_whole
from reproduction.ledger.tables import Table

HERE = Path(__file__).parent
PAIRS = {
    "kf-lf-a": "Kalman A, against Lainiotis A",
    "kf-lf-b": "Kalman B, against Lainiotis B",
    "kf-a-sskf-b": "steady state B, against Kalman A",
    "lf-a-sslf-b": "steady state B, against Lainiotis A",
}


def tables(results):
    """Return the tables of README.md, by the names of their places in it."""
    met = {True: "yes", False: "**no**", None: ""}
    rows = [
        [
            each["work"],
            f"{each['tracks']:,}" if each.get("tracks") else "",
            each["against"],
            number(each.get("ms")),
            number(each.get("against_ms")),
            in_words(each),
            each["goal"].replace(" x faster", "").replace("<= ", "≤").replace(">= ", "≥"),
            met[each["met"]],
        ]
        for each in results["rows"]
    ]
    head = "work", "tracks", "against", "ms", "its ms", "ratio", "goal", "reached"
    clock = [
        [paper[:4], PAIRS[pair], *(number(values[kind]) for kind in ("one", "own", "shared"))]
        for paper, pairs in results["speedups"].items()
        for pair, values in pairs.items()
    ]
    clock_head = "paper", "how many times as fast", "one track", "many, own covariance", "many, shared"
    described = [f"{k}: {v}" for k, v in (results["machine"] | results["versions"]).items()]
    return {
        "machine": ", ".join(described) + ".",
        "rows": Table(head, rows).markdown(),
        "speedups": Table(clock_head, clock).markdown(),
        "three-axes": three_axes(results["three axes"]).markdown(),
        "commands": f"```text\n{results['commands']}\n```",
    }


def three_axes(rows):
    """Return the table of the ways to run a filter for three axes: operations, and times over that of the first."""
    lines = []
    for each in rows:
        times = [f"{each[kind]:.2g}" if kind in each else "" for kind in ("one", "many")]
        lines.append([each["name"], f"{each['operations']:,}", *times])
    head = "one step for three axes", "operations", "time, one phone", "time, many phones"
    return Table(head, lines)


def in_words(row):
    """Return the ratio of a row with its direction: without a goal, that of the median times."""
    longer = row["goal"].startswith("<=") if row["goal"] else (row["ratio"] > 1) == (row["ms"] > row["against_ms"])
    return f"{number(row['ratio'])}× as {'long' if longer else 'fast'}".replace(" ", "\N{NO-BREAK SPACE}")


def number(value):
    """Return a number as text of three digits, and nothing for none."""
    return "" if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def filled(text, places):
    """Return a text with what stands between <!-- name --> and <!-- /name --> replaced."""
    for name, new in places.items():
        before, rest = text.split(f"<!-- {name} -->\n")
        text = f"{before}<!-- {name} -->\n{new}\n<!-- /{name} -->" + rest.split(f"<!-- /{name} -->")[1]
    return text


def write_readme():
    """Fill the tables of README.md from results.json."""
    readme = HERE / "README.md"
    results = json.loads((HERE / "results.json").read_text(encoding="utf-8"))
    write_whole(readme, filled(readme.read_text(encoding="utf-8"), tables(results)).encode())
