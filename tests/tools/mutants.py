"""Break a copy of the project, one way at a time, and see that the tests go red: `make mutants`.

`python tests/tools/mutants.py smoothing` runs those whose file or description matches a regular expression.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tqdm import tqdm

from mpt_helpers.tracks.files import write_whole
from reproduction.ledger.tables import Table

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "tests" / "mutants.md"
HEAD = "# What was broken, and which test saw it first\n"
LEAST = 0.95  # of the mutants must be caught
NOT_RUN = "not run"  # what the table says of a mutant that was not tried since the code changed


class Mutant(NamedTuple):
    """A change of one place in one file."""

    file: str
    old: str
    new: str
    what: str


def mutants():
    """Return all Mutants."""
    return [Mutant(*each) for each in _read()["mutants"]]


def _read():
    return tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def mutated(mutant, text):
    """Return the text with the change; raises ValueError unless what is changed stands there once."""
    if text.count(mutant.old) != 1:
        raise ValueError(f"{mutant.file}: needs {mutant.old!r} once, got it {text.count(mutant.old)} times")
    return text.replace(mutant.old, mutant.new)


def seen_by(mutant):
    """Return the paths of the tests that can see a mutant, those that see most and take least first.

    mutants.toml has them for each file, or for a folder as a whole.
    """
    patterns = next(patterns for start, patterns in _read()["seen_by"].items() if mutant.file.startswith(start))
    return [path.relative_to(ROOT).as_posix() for pattern in patterns for path in sorted(ROOT.glob(pattern))]


def caught_by(mutant):
    """Return the first test that sees the mutant, or None."""
    with TemporaryDirectory() as place:
        copy = Path(place) / "project"
        tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, tracked.split("\0")):
            copy.joinpath(name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, copy / name)
        path = copy / mutant.file
        path.write_text(mutated(mutant, path.read_text(encoding="utf-8")), encoding="utf-8")
        return first_failure(copy, seen_by(mutant))


def first_failure(project, tests):
    """Return the first of these tests that fails in a copy of the project, or None."""
    here = os.environ | {"PYTHONPATH": str(project), "PYTHONDONTWRITEBYTECODE": "1"}  # before the installed package
    notebooks = [test for test in tests if test.endswith(".ipynb")]
    others = [test for test in tests if test not in notebooks]
    of_tests = ["--hypothesis-profile=mutants", *others] if others else []  # tests/conftest.py has that profile
    of_notebooks = ["-p", "tests.support.exact", "--nbval", "--nbval-current-env", *notebooks] if notebooks else []
    for stage in (of_tests, of_notebooks):
        if stage:
            command = [sys.executable, "-m", "pytest", "-q", "-x", "--color=no", "-p", "no:cacheprovider", *stage]
            run = subprocess.run(command, cwd=project, env=here, capture_output=True, text=True)
            if run.returncode:
                found = re.findall(r"(?m)^(?:FAILED|ERROR) (\S+)", run.stdout)
                return found[0] if found else "the tests do not start"
    return None


def table(caught):
    """Return the summary and the table of mutants.md."""
    rows = []
    for mutant, test in caught:
        seen = test if test == NOT_RUN else f"`{test}`" if test else "**no test**"
        rows.append((mutant.what, f"`{mutant.file}`", seen))
    tried = [test for _, test in caught if test != NOT_RUN]
    summary = f"{sum(test is not None for test in tried)} of {len(tried)} are seen."
    if len(tried) < len(caught):
        summary += f" {len(caught) - len(tried)} were not run since the code changed."
    return f"{summary}\n\n{Table(('what is broken', 'where', 'seen first by'), rows).markdown()}\n"


def stored():
    """Return what mutants.md says each mutant was seen by: {(what, file): the text of that cell}."""
    rows = [line.strip("| ").split(" | ") for line in TABLE.read_text(encoding="utf-8").splitlines() if "| `" in line]
    return {(what, file.strip("`")): seen for what, file, seen in rows}


def as_stored(mutant, table):
    """Return what a mutant that is not run now was caught by, from the table of `stored`."""
    seen = table.get((mutant.what, mutant.file), NOT_RUN)
    return None if seen == "**no test**" else seen.strip("`")


def write_table(caught):
    """Write the table of (mutant, what it was caught by) into mutants.md."""
    write_whole(TABLE, f"{HEAD}\n{table(caught)}".encode())


def main():
    """Run all mutants, or those selected, write the table, and return 1 when too few are caught."""
    selected = sys.argv[1] if len(sys.argv) > 1 else ""
    every = [mutant for mutant in mutants() if re.search(selected, f"{mutant.file} {mutant.what}")]
    if not every:
        print(f"error: no mutant matches {selected!r}", file=sys.stderr)
        return 1
    failing = first_failure(ROOT, list(dict.fromkeys(test for mutant in every for test in seen_by(mutant))))
    if failing:
        print(f"error: {failing} fails in the project as it is", file=sys.stderr)
        return 1
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = list(tqdm(pool.map(caught_by, every), total=len(every), desc="mutants"))
    caught = list(zip(every, found, strict=True))
    share = sum(test is not None for test in found) / len(found)
    now, before = dict(caught), stored()
    write_table([(mutant, now[mutant] if mutant in now else as_stored(mutant, before)) for mutant in mutants()])
    for mutant, test in caught:
        if test is None:
            print(f"no test sees: {mutant.what} ({mutant.file})", file=sys.stderr)
    print(f"{share:.1%} are seen")
    return int(share < LEAST)


if __name__ == "__main__":
    sys.exit(main())
