"""A pytest plugin, `-p tests.support.exact`: nbval holds each notebook to every committed byte, beside any other tests.

nbval alone skips pictures and metadata, and the files that a notebook writes. With this plugin it compares them too:
PNG and SVG, the alt text and the description of each figure, which must also change when anything drawn changes by one
percent. The kernel works at the project's root, where `make reproduce` works in notebooks/: both must give the same.
"""

import gc
import os
import re
import sys
import tempfile
from pathlib import Path

import pytest

from reproduction.execute import settings_of_nobody
from tests.support.drawn import DRAWN
from tests.support.sockets import talk_through_files

# Or jsonschema, which nbval's plugin imports, takes seconds to make a grammar of web addresses: notebooks need none.
sys.modules.setdefault("rfc3987_syntax", None)

TESTS = Path(__file__).parent
NOT_SEEN = ("execution_count", "prompt_number", "traceback")  # the count is tested where nothing runs
STARTUP = "startup.py"  # in this folder: what a kernel runs before its first cell
# Each processor takes whole files, since the tests of a file share a kernel, or what takes seconds to make. First the
# longest ones, that no processor has to wait for another at the end. The tests of some are spread one by one.
LONGEST = ("test_guide.py", "2007_mms_kalman.ipynb", "test_track_command.py", "what_averaging_leaves.ipynb", ".ipynb")
SPREAD = (
    "test_engine.py",
    "test_hard_numbers.py",
    "test_fit.py",
    "test_gate.py",
    "test_reported.py",
    "test_reproduce.py",
)


def pytest_configure(config):
    """Make the folder into which the kernels draw, and in it the code that each runs before its first cell."""
    talk_through_files()
    drawn = tempfile.TemporaryDirectory(prefix="drawn-")
    config.add_cleanup(drawn.cleanup)
    os.environ[DRAWN] = drawn.name
    Path(drawn.name, STARTUP).write_text('__import__("drawn").watch()\n', encoding="utf-8")  # leaves no name behind


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out files whole, or their tests one by one, in the order of `pytest_collection_modifyitems`."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduler(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return nodeid if file.endswith(SPREAD) else file

    config.option.loadscopereorder = False
    return Scheduler(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Let no collection of garbage look at the thousands of tests: they stay."""
    gc.disable()
    collected = yield
    gc.freeze()
    gc.enable()
    return collected


def pytest_collection_modifyitems(items):
    """Put the longest files first, and what is spread last: it fills what is left of each processor's time."""

    def place(item):
        file = item.nodeid.partition("::")[0]
        among_longest = [k for k, end in enumerate(LONGEST) if file.endswith(end)]
        return among_longest[0] if among_longest else len(LONGEST) + file.endswith(SPREAD)

    items.sort(key=place)


def is_cell(item):
    """Say whether a test is a notebook's cell."""
    return hasattr(item, "cell")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    """Let the kernel of a notebook, which its first cell starts, run `watch`; kernels of other tests must not."""
    with pytest.MonkeyPatch.context() as here:
        if is_cell(item):
            for name, value in settings_of_nobody(Path(os.environ[DRAWN])).items():
                here.setenv(name, value)
            here.setenv("PYTHONSTARTUP", os.path.join(os.environ[DRAWN], STARTUP))
            here.setenv("PYTHONPATH", str(TESTS), prepend=os.pathsep)
        return (yield)


def pytest_collectstart(collector):
    """Compare all of an output: nbval's own way to say what is skipped."""
    if hasattr(collector, "skip_compare"):
        collector.skip_compare = NOT_SEEN


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Run a test; if it is a cell, compare the files of its figures with the committed ones."""
    result = yield
    names = re.findall(r'save_figure\([^"]+, "(\w+)"\)', item.cell.source) if is_cell(item) else []
    for name in names:
        for file in (f"{name}.png", f"{name}.svg"):
            drawn, committed = Path(os.environ[DRAWN], file), item.config.rootpath / "figures" / file
            assert drawn.read_bytes() == committed.read_bytes(), f"figures/{file} is not what this cell draws"
    return result
