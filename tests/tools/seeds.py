"""Does a verdict that rests on simulation depend on the seed? `make seeds [KEYS="2016_prediction"]`, some minutes each.

Each notebook with such verdicts runs with 25 other values of its one line `SEED = ...`. seeds.csv beside this file says
for each verdict in how many of the 25 runs it came out as it is stored; tests/test_seeds.py holds all of them to 24.
"""

import asyncio
import csv
import io
import json
import os
import re
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from mpt_helpers.tracks.files import write_whole
from reproduction.execute import settings_of_nobody
from reproduction.ledger import keys, stored_verdicts
from reproduction.ledger.verdicts import IN_PART
from reproduction.project import NOTEBOOKS, project
from reproduction.runner import staged

SEEDS = 25
LEAST = 24
COLUMNS = ("paper", "id", "verdict", "agree")
TABLE = Path("tests") / "tools" / "seeds.csv"
SEED_LINE = re.compile(r"^SEED = (\d+)\b", re.MULTILINE)


def outcome(verdict):
    """Return what must not depend on the seed: the verdict and, where a claim holds in part, in which part."""
    return (verdict.verdict, verdict.reason if verdict.verdict == IN_PART else "")


def simulated(notebook):
    """Return the Verdicts of an executed notebook that rest on simulation, by id."""
    return {each.id: each for each in stored_verdicts(notebook) if each.basis == "simulation"}


def with_seed(notebook, seed):
    """Return a notebook with another seed, and the seed that it had; raises ValueError without exactly one."""
    found = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            text = "".join(cell["source"])
            found += SEED_LINE.findall(text)
            cell["source"] = SEED_LINE.sub(f"SEED = {seed}", text)
    if len(found) != 1:
        raise ValueError(f"needs one line `SEED = <int>`, got {len(found)}")
    return notebook, int(found[0])


def other_seeds(own):
    """Return the 25 seeds from 1 on that the notebook does not have itself."""
    return [seed for seed in range(1, SEEDS + 2) if seed != own][:SEEDS]


def run(root, key, seed):
    """Execute a notebook with another seed in a copy of the project; return its outcomes by id, and its errors.

    A cell that fails does not end the run: what it would have reported has no outcome.
    """
    import nbformat
    from nbclient import NotebookClient

    with staged(root) as stage:
        path = stage / NOTEBOOKS / f"{key}.ipynb"
        notebook, _ = with_seed(nbformat.read(path, as_version=4), seed)
        client = NotebookClient(
            notebook,
            timeout=600,
            kernel_name="python3",
            extra_arguments=["--IPKernelApp.log_level=50"],  # its warnings are not about the notebook
            resources={"metadata": {"path": str(path.parent)}},
            allow_errors=True,
        )
        # A loop for each thread.
        asyncio.run(client.async_execute(env=os.environ | settings_of_nobody(stage)))
        nbformat.write(notebook, path)
        outcomes = {id: outcome(each) for id, each in simulated(path).items()}
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    return outcomes, [f"{out.ename}: {out.evalue}" for out in outputs if out.output_type == "error"]


def agreement(root, some, workers=2):
    """Return rows of the table: the verdicts of some papers that rest on simulation, and how many seeds agree."""
    committed = {key: simulated(root / NOTEBOOKS / f"{key}.ipynb") for key in some}
    agree = Counter()
    started = time.monotonic()
    with ThreadPoolExecutor(workers) as pool:
        runs = {}
        for key in some:
            notebook = json.loads((root / NOTEBOOKS / f"{key}.ipynb").read_text(encoding="utf-8"))
            for seed in other_seeds(with_seed(notebook, 0)[1]) if committed[key] else []:
                runs[pool.submit(run, root, key, seed)] = key, seed
        for done, future in enumerate(as_completed(runs), 1):
            key, seed = runs[future]
            outcomes, errors = future.result()
            differ = [id for id, each in committed[key].items() if outcomes.get(id) != outcome(each)]
            agree.update((key, id) for id in committed[key] if id not in differ)
            left = (time.monotonic() - started) * (len(runs) - done) / done
            what = ", ".join(differ) or "nothing"
            print(f"{key}, seed {seed}: {what} differs; {done} of {len(runs)}, some {left:.0f} s left", flush=True)
            if errors:  # those after the first mostly follow from it
                print(f"  {len(errors)} cells failed, the first with {errors[0]}", flush=True)
    return [
        {"paper": key, "id": id, "verdict": each.verdict, "agree": agree[key, id]}
        for key in some
        for id, each in committed[key].items()
    ]


def read_table(root):
    """Return the rows of the committed table."""
    with (root / TABLE).open(encoding="utf-8", newline="") as file:
        return [row | {"agree": int(row["agree"])} for row in csv.DictReader(file)]


def write_table(root, rows):
    """Write the table, whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(root / TABLE, text.getvalue().encode())


def main(some):
    """Run the notebooks of these papers, or of all, and write their rows; returns the exit code."""
    root = project()
    others = [row for row in read_table(root) if some and row["paper"] not in some] if some else []
    rows = sorted(others + agreement(root, some or keys()), key=lambda row: row["paper"])
    write_table(root, rows)
    for row in rows:
        print(f"{row['agree']} of {SEEDS}  {row['paper']}  {row['id']}: {row['verdict']}")
    return int(any(row["agree"] < LEAST for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
