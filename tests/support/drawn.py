"""In the kernel of a notebook under `exact`: each figure is tested, and saved elsewhere. It takes no pytest for it."""

import os
from types import SimpleNamespace

DRAWN = "MPT_HELPERS_DRAWN"  # names the folder into which the kernels draw


def watch():
    """In the kernel: go to the project's root, test each figure that is saved, and save it elsewhere."""
    from reproduction import figures

    os.chdir(figures.project())
    save = figures.save_figure

    def save_figure(fig, name):
        figures.project()  # is found from here too
        every_change_is_described(fig, figures)
        return save(fig, name, os.environ[DRAWN])

    figures.save_figure = save_figure


def every_change_is_described(fig, figures):
    """Scale each line, area, bar and image by 1.01, one at a time: the description, which nbval compares, must change.

    Drawn values below figures.QUANTUM are described with one digit, and left out here; of many bars, twenty are tried.
    """
    for outer in fig.axes:
        alone = SimpleNamespace(axes=[outer], texts=[], legends=[])  # faster than the whole figure each time
        before = figures.describe(alone)
        for ax in (outer, *outer.child_axes):
            for artist in (*ax.lines, *ax.collections, *ax.patches[:20], *ax.images):
                for values, put in drawn_numbers(artist):
                    if max(map(abs, values.ravel()), default=0) > figures.QUANTUM:
                        put(1.01 * values)
                        changed = figures.describe(alone) != before
                        assert changed, f"1 % more is not described: {artist} {artist.get_label()}"
                        put(values)
        assert figures.describe(alone) == before


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
