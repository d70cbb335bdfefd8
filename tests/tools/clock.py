"""How long the everyday commands take: `make clock`, on a machine that does nothing else.

Each is measured by the processor time of everything that it starts, and given as a multiple of a fixed piece of numpy
work, which differs less from machine to machine than seconds do.
"""

import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from reproduction.ledger import Table

ROOT = Path(__file__).parents[2]
NBVAL = ["-p", "tests.support.exact", "--nbval", "--nbval-current-env"]
TESTS = ["mpt_helpers", "reproduction", "docs/break_sensor.py", "tests", "notebooks"]
COMMANDS = {
    "`make reproduce`": ["-m", "reproduction", "reproduce"],
    "`make test`": ["-m", "pytest", "-q", "-n", "auto", *NBVAL, "-m", "not slow", *TESTS],
}


def numpy_work():
    """Return the processor time of the fixed work: 100,000 steps of 2,000 tracks of four states, on one core."""
    start = time.process_time()
    A = 0.9 * np.eye(4)
    x = np.ones((4, 2000))
    for _ in range(100_000):
        x = np.einsum("ij,jm->im", A, x) + 0.1
    return time.process_time() - start


def spent():
    """Return the processor time of all child processes so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main():
    """Run each command once and print the table."""
    unit = min(numpy_work() for _ in range(3))
    rows = []
    for name, arguments in COMMANDS.items():
        wall, before = time.monotonic(), spent()
        subprocess.run([sys.executable, *arguments], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        used = spent() - before
        rows.append([name, f"{time.monotonic() - wall:.0f}", f"{used:.0f}", f"{used / unit:.0f}"])
    print(Table(["command", "seconds", "processor seconds", f"times numpy's work ({unit:.2f} s)"], rows))


if __name__ == "__main__":
    main()
