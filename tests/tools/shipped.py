"""Build the package, install it into clean environments and use it there: `make build`, `make extras`.

    python tests/tools/shipped.py            wheel and sdist into dist/; the README's code runs on the installed wheel
    python tests/tools/shipped.py gps ...    the wheel with these extras, each in an environment of its own

What is installed comes from the package index, in the newest versions that pyproject.toml allows.
"""

import gzip
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

from flit_core import buildapi

ROOT = Path(__file__).parents[2]
DIST = ROOT / "dist"
README_CODE = "\n".join(re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL))

LIGHT = """\
import importlib.util, sys, mpt_helpers
loaded = [name for name in ("matplotlib", "nbformat", "distributed") if name in sys.modules]
assert not loaded, loaded
assert importlib.util.find_spec("reproduction") is None"""
DASK = """\
import numpy as np
from distributed import Client
import mpt_helpers as mpt

axis = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
kf = mpt.KalmanFilter(axis)

def last_error(rng, M):
    x, z = mpt.simulate(axis, 20, rng, tracks=M)
    return (kf.filter(z) - x)[-1, 0]

if __name__ == "__main__":
    with Client(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as client:
        spread = mpt.study(last_error, runs=5000, seed=1, workers=client.get_executor().map)
    assert np.array_equal(spread, mpt.study(last_error, runs=5000, seed=1))"""
GPS = """\
import sys, hatanaka
with open(sys.argv[1], "rb") as raw:
    packed = hatanaka.compress(raw.read(), compression="gz")
open("observations.crx.gz", "wb").write(packed)"""


def metadata():
    """Return the table `project` of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def build(folder):
    """Make wheel and sdist in a folder that is emptied first, and return their paths."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder / buildapi.build_wheel(folder), folder / buildapi.build_sdist(folder)


class Environment:
    """A clean environment with a wheel and some of its extras, and an empty folder to work in."""

    def __init__(self, folder, what):
        folders = ("Scripts", "python.exe") if sys.platform == "win32" else ("bin", "python")
        self.python = folder.joinpath("venv", *folders)
        self.here = folder / "work"
        self.here.mkdir()
        subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
        self.run("-m", "pip", "install", "--quiet", "--disable-pip-version-check", what)

    def run(self, *arguments):
        """Run its Python; raises CalledProcessError where that fails, after what it said."""
        subprocess.run([self.python, *arguments], cwd=self.here, check=True)

    def script(self, text, *arguments):
        """Run a text as a script."""
        path = self.here / "script.py"
        path.write_text(text, encoding="utf-8")
        self.run(path, *arguments)


def use_base(there):
    """Run the README's code and the command line; the package itself loads no library for pictures or notebooks."""
    there.script(README_CODE)
    there.script(LIGHT)
    there.script("import mpt_helpers.__main__")


def use_notebooks(there):
    """Unpack the sdist, execute a notebook in it and see its figures."""
    with tarfile.open(next(DIST.glob("*.tar.gz"))) as archive:
        archive.extractall(there.here, filter="data")
    (there.here,) = there.here.iterdir()
    shutil.rmtree(there.here / "mpt_helpers")  # the wheel's is installed
    for drawn in there.here.glob("figures/2015_mpt_3d_*"):
        drawn.unlink()
    there.run("-m", "reproduction", "reproduce", "2015_mpt_3d")
    made = {path.name for path in there.here.glob("figures/2015_mpt_3d_*")}
    assert made == {path.name for path in ROOT.glob("figures/2015_mpt_3d_*")}, made


def use_dask(there):
    """Run a study on a cluster of two processes: the same numbers as in one."""
    there.script(DASK)


def use_gps(there):
    """Make the table of two satellites at two epochs from RINEX: the rows of the committed table of the whole day.

    The committed table's code biases are means over the day of all satellites, so that they are given.
    """
    there.script(GPS, ROOT / "tests" / "rinex" / "observations.rnx")
    navigation = there.here / "navigation.rnx.gz"
    navigation.write_bytes(gzip.compress((ROOT / "tests" / "rinex" / "navigation.rnx").read_bytes()))
    committed = rows(ROOT / "notebooks" / "data" / "esbc_2020_177.csv.gz")
    ranges = [row.split(",") for row in committed if row[0].isdigit()]
    bias = {f"G{int(row[1]):02}": float(row[-1]) / 0.299792458 for row in ranges}  # ns
    lines = ["satellite,C1C_minus_C1W_ns", *(f"{satellite},{value}" for satellite, value in bias.items())]
    (there.here / "biases.csv").write_text("\n".join(lines), encoding="utf-8")
    make = ROOT / "notebooks" / "data" / "make_table.py"
    there.run(make, "observations.crx.gz", navigation, "table.csv.gz", "--biases", "biases.csv")
    made = rows(there.here / "table.csv.gz")
    assert len(made) == 6, made  # the station, the columns, four ranges
    assert made <= committed, made


def rows(path):
    """Return the lines of a compressed table."""
    return set(gzip.decompress(path.read_bytes()).decode().splitlines())


USES = {"notebooks": use_notebooks, "dask": use_dask, "gps": use_gps}


def main(extras):
    """Build, install and use."""
    wheel, sdist = build(DIST)
    for extra in extras or [""]:
        with TemporaryDirectory() as folder:
            there = Environment(Path(folder), f"{wheel}[{extra}]" if extra else wheel)
            if extra:
                USES[extra](there)
            else:
                use_base(there)
                there.run("-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", there.here, sdist)
                assert names(there.here / wheel.name) == names(wheel), "the sdist makes another wheel"
        print(f"installed from {wheel.name}{f' with the extra {extra}' if extra else ''}, and used: all is well")


def names(wheel):
    """Return the names of the files in a wheel."""
    return zipfile.ZipFile(wheel).namelist()


if __name__ == "__main__":
    main(sys.argv[1:])
