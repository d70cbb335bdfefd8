"""A pytest plugin, `-p tests.exact`: one run of nbval holds each notebook to every committed byte.

nbval alone skips pictures and metadata, and the files that a notebook writes. With this plugin it compares them too:
PNG and SVG, the alt text and the description of each figure, which must also change when anything drawn changes by one
percent. The kernel works at the project's root, where `make reproduce` works in notebooks/: both must give the same.
"""

import os
import re
import tempfile
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
NOT_SEEN = ("execution_count", "prompt_number", "traceback")  # the count is tested where nothing runs
DRAWN = "MPT_HELPERS_DRAWN"  # names the folder into which the kernels draw


def pytest_configure(config):
    """Let each kernel that nbval starts run `watch` before the first cell."""
    drawn = tempfile.TemporaryDirectory(prefix="drawn-")
    config.add_cleanup(drawn.cleanup)
    os.environ[DRAWN] = drawn.name
    startup = Path(drawn.name, "startup.py")
    startup.write_text('__import__("exact").watch()\n')  # leaves no name behind
    os.environ["PYTHONSTARTUP"] = str(startup)
    os.environ["PYTHONPATH"] = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])


def pytest_collectstart(collector):
    """Compare all of an output: nbval's own way to say what is skipped."""
    if hasattr(collector, "skip_compare"):
        collector.skip_compare = NOT_SEEN


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Run a cell, and compare the files of its figures with the committed ones."""
    result = yield
    for name in re.findall(r'save_figure\(\w+, "(\w+)"\)', item.cell.source):
        for file in (f"{name}.png", f"{name}.svg"):
            drawn, committed = Path(os.environ[DRAWN], file), item.path.parents[1] / "figures" / file
            assert drawn.read_bytes() == committed.read_bytes(), f"figures/{file} is not what this cell draws"
    return result


def watch():
    """In the kernel: go to the project's root, test each figure that is saved, and save it elsewhere."""
    from mpt_helpers import plots

    os.chdir("..")
    save = plots.save_figure

    def save_figure(fig, name):
        plots.figures_folder()  # is found from here too
        every_change_is_described(fig, plots)
        return save(fig, name, os.environ[DRAWN])

    plots.save_figure = save_figure


def every_change_is_described(fig, plots):
    """Scale each line, area, bar and image by 1.01, one at a time: the description, which nbval compares, must change.

    Drawn values below plots.QUANTUM are described with one digit, and left out here; of many bars, twenty are tried.
    """
    before = plots.describe(fig)
    for ax in (ax for outer in fig.axes for ax in (outer, *outer.child_axes)):
        for artist in (*ax.lines, *ax.collections, *ax.patches[:20], *ax.images):
            for values, put in drawn_numbers(artist):
                if max(map(abs, values.ravel()), default=0) > plots.QUANTUM:
                    put(1.01 * values)
                    assert plots.describe(fig) != before, f"1 % more is not described: {artist} {artist.get_label()}"
                    put(values)
    assert plots.describe(fig) == before


def drawn_numbers(artist):
    """Yield each array of numbers that an artist draws, and how to put another in its place."""
    import numpy as np

    if hasattr(artist, "get_data_3d"):
        yield np.array(artist.get_data_3d()), lambda data: artist.set_data_3d(*data)
    elif hasattr(artist, "get_xdata"):
        yield np.array(artist.get_xdata(), float), artist.set_xdata
        yield np.array(artist.get_ydata(), float), artist.set_ydata
    elif hasattr(artist, "get_height"):
        yield np.array(artist.get_height(), float), artist.set_height
        yield np.array(artist.get_width(), float), artist.set_width
    elif hasattr(artist, "get_offsets") and len(artist.get_offsets()) > 1:
        yield np.array(artist.get_offsets(), float), artist.set_offsets
    elif hasattr(artist, "get_paths"):
        for path in artist.get_paths():
            yield path.vertices.copy(), lambda vertices, path=path: setattr(path, "vertices", vertices)
    if hasattr(artist, "get_array") and artist.get_array() is not None:
        yield np.array(artist.get_array(), float), artist.set_array
