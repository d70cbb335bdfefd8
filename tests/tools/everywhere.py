"""Run the tests and nbval on every Python, BLAS core type and set of versions that is promised: `make test-all`."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MINORS = (11, 12, 13, 14)
CORES = ("Nehalem", "SkylakeX")  # OpenBLAS for an old processor and for a new one: other last bits
LIBRARIES = ("numpy", "scipy", "matplotlib", "filterpy")
# Another matplotlib draws other pixels: then nbval compares what a figure plots in words only.
EXACT = ("-p", "tests.support.exact")


class Place(NamedTuple):
    """Where the tests run: a name, a Python, what pip installs, variables, and how nbval compares there."""

    name: str
    python: str
    install: list
    variables: dict
    compare: tuple = EXACT


def pythons():
    """Return the Python of each minor version that this machine has, by its number."""
    found = {}
    for minor in MINORS:
        kept = sorted(Path.home().glob(f".pyenv/versions/3.{minor}.*/bin/python3"))
        for candidate in filter(None, (shutil.which(f"python3.{minor}"), *map(str, kept))):
            run = subprocess.run([candidate, "-c", "import venv, ensurepip"], capture_output=True)
            if run.returncode == 0:
                found.setdefault(minor, candidate)
    return found


def places():
    """Return all Places."""
    locked, there = ["--require-hashes", "-r", "environment.lock"], pythons()
    oldest = [each.replace(">=", "==") for each in PROJECT["dependencies"]]
    extras = PROJECT["optional-dependencies"]
    others = [*extras["notebooks"], *extras["test"]]
    newest = [re.split("[=<>]", each)[0] for each in [*PROJECT["dependencies"], *others]]
    first, last = there[min(there)], there[max(there)]
    return [
        *(Place(f"Python 3.{minor}", python, locked, {}) for minor, python in there.items()),
        *(Place(f"core type {core}", first, locked, {"OPENBLAS_CORETYPE": core}) for core in CORES),
        Place("oldest versions", first, [*oldest, *others], {}, ()),
        Place("newest versions", last, newest, {}, ()),
    ]


def tried(place):
    """Return a row of the table: the versions, the results of pytest and of nbval, and the minutes they took."""
    start = time.monotonic()
    with TemporaryDirectory() as folder:
        copy, python = Path(folder) / "project", Path(folder) / "venv" / "bin" / "python"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".venv*", "_build", ".*_cache"))
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        steps = [
            [place.python, "-m", "venv", python.parent.parent],
            [*pip, *place.install],
            [*pip, "--no-deps", "-e", "."],
        ]
        for step in steps:
            run = subprocess.run(step, cwd=copy, capture_output=True, text=True)
            if run.returncode:
                return [place.name, "-", "not installed: " + run.stderr.strip()[-200:], "-", "-"]
        code = f"import json, importlib.metadata as m; print(json.dumps([m.version(each) for each in {LIBRARIES}]))"
        versions = json.loads(subprocess.run([python, "-c", code], capture_output=True, text=True).stdout)
        results = []
        nbval = [*place.compare, "--nbval", "--nbval-current-env", "notebooks"]
        for arguments in (["-p", "no:nbval"], nbval):
            log = ROOT / ".test-all" / f"{place.name} {len(results)}.txt"
            log.parent.mkdir(exist_ok=True)
            command = [python, "-m", "pytest", "-q", "--color=no", "-n", "auto", "--dist", "loadfile", *arguments]
            run = subprocess.run(command, cwd=copy, env=os.environ | place.variables, capture_output=True, text=True)
            log.write_text(run.stdout + run.stderr)
            results.append(re.sub(r" in .*|=", "", (run.stdout.strip().splitlines() or ["no output"])[-1]).strip())
    minutes = f"{(time.monotonic() - start) / 60:.0f}"
    return [place.name, ", ".join(map(" ".join, zip(LIBRARIES, versions, strict=True))), *results, minutes]


def main():
    """Try every place, print the table, and return 1 when a test failed."""
    rows = []
    for place in places():
        rows.append(tried(place))
        print(*rows[-1], sep=" | ", flush=True)
    head = ["place", "versions", "tests", "nbval", "minutes"]
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    print()
    for row in [head, *rows]:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return int(not all(passed(result) for row in rows for result in row[2:4]))


def passed(result):
    """Say whether the last line of pytest tells of no failure and no error."""
    return re.fullmatch(r"\d+ passed(, \d+ (skipped|deselected))*", result) is not None


if __name__ == "__main__":
    sys.exit(main())
