"""A figure's description must notice what a reader would, and nothing that only a processor would."""

import re
from datetime import date
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from reproduction import figures, plots
from reproduction.figures import alt_text, describe, save_figure
from reproduction.plots import finish, panels


def line(ax, y):
    ax.plot(np.arange(len(y)), y)


def band(ax, y):
    ax.fill_between(np.arange(len(y)), y, y + 3)


def scatter(ax, y):
    ax.scatter(np.arange(len(y)), y)


def bars(ax, y):
    ax.bar(np.arange(len(y)), y)


def one_dot(ax, y):
    ax.scatter(*y[:2])
    ax.set(xlim=(0, 200), ylim=(0, 200))


def steps(ax, y):
    ax.step(np.arange(len(y)), y)


def stairs(ax, y):
    ax.stairs(y)


def image(ax, y):
    ax.imshow(np.outer(y, y))


def heat_map(ax, y):
    ax.pcolormesh(np.outer(y, y))


def contours(ax, y):
    ax.contourf(np.outer(y, y))


def words(change):
    fig, ax = panels([["a"]])
    line(ax["a"], np.arange(3.0))
    change(fig, ax["a"])
    return describe(fig)


DRAWN = [line, band, scatter, bars, steps, stairs, image, heat_map, contours]


@pytest.mark.parametrize("draw", DRAWN)
def test_a_change_of_one_percent_in_any_point_is_described(draw):
    y = np.random.default_rng(0).uniform(1, 100, 8)
    described = set()
    for i in range(-1, len(y)):
        moved = y.copy()
        if i >= 0:
            moved[i] *= 1.01
        fig, ax = panels([["a"]])
        draw(ax["a"], moved)
        described.add(describe(fig))
    assert len(described) == len(y) + 1


def test_two_scatters_of_one_point_each_have_another_checksum():
    described = []
    for y in ([1.0, 2.0], [1.0, 3.0]):
        fig, ax = panels([["a"]])
        one_dot(ax["a"], y)
        described.append(describe(fig))
    assert described[0] != described[1]


def test_a_scatter_of_one_point_at_the_origin_is_no_area():
    fig, ax = panels([["a"]])
    one_dot(ax["a"], [0.0, 0.0])
    assert "points '_child0': 1 points, x 0..0 mean 0, y 0..0 mean 0" in describe(fig)


def test_two_heat_maps_with_rows_and_columns_exchanged_are_not_the_same():
    described = []
    for values in (np.arange(9.0).reshape(3, 3), np.arange(9.0).reshape(3, 3).T):
        fig, ax = panels([["a"]])
        ax["a"].imshow(values)
        described.append(describe(fig))
    assert described[0] != described[1]


@pytest.mark.parametrize(
    "draw",
    [
        lambda ax: ax.plot([], []),
        lambda ax: ax.plot([date(2020, 1, day) for day in (1, 2, 3)], [1, 2, 3]),
        lambda ax: ax.plot([1, 2], ["low", "high"]),
        lambda ax: ax.bar(["KF", "LF"], [509, 670]),
        lambda ax: ax.plot([1, np.nan, 3]),
        lambda ax: ax.pcolormesh(np.ma.masked_equal(np.eye(3), 0)),
    ],
)
def test_empty_lines_dates_texts_and_gaps_are_saved(tmp_path, draw):
    fig, ax = panels([["a"]])
    draw(ax["a"])
    finish(ax["a"], "x", "title")
    assert "nan" not in save_figure(fig, "a", tmp_path).description


def test_a_figure_is_saved_whole_or_not_at_all(tmp_path):
    (tmp_path / "a.svg").mkdir()
    fig, _ = panels([["a"]])
    with pytest.raises(IsADirectoryError):
        save_figure(fig, "a", tmp_path)
    assert not (tmp_path / "a.png").exists()


def test_the_figure_that_is_saved_is_not_changed(tmp_path):
    fig, ax = panels([["a"]])
    y = np.array([1 / 3, 2 / 3])
    line(ax["a"], y)
    area = ax["a"].fill_between([0, 1], y)
    save_figure(fig, "a", tmp_path)
    np.testing.assert_array_equal(ax["a"].lines[0].get_ydata(), y)
    assert 2 / 3 in area.get_paths()[0].vertices
    assert fig.get_layout_engine() is not None
    ax["a"].plot([5, 6])  # limits still follow the data
    assert ax["a"].get_ylim()[1] > 6


def test_figures_are_found_from_the_root_and_from_the_notebooks_and_nowhere_else(tmp_path, monkeypatch):
    project, fig = tmp_path / "project", panels([["a"]])[0]
    for folder in ("notebooks", "figures", "docs"):
        (project / folder).mkdir(parents=True)
    (project / "notebooks" / "paper.ipynb").touch()
    for place in (project, project / "notebooks"):
        monkeypatch.chdir(place)
        save_figure(fig, f"from_{place.name}")
    assert len(list((project / "figures").iterdir())) == 4
    (tmp_path / "figures").mkdir()
    for place in (tmp_path, project / "docs"):
        monkeypatch.chdir(place)
        with pytest.raises(FileNotFoundError, match="needs the project's root or its notebooks/"):
            save_figure(fig, "elsewhere")
    with pytest.raises(ValueError, match="name: needs letters, digits and underscores"):
        save_figure(fig, "../a", tmp_path)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == set(project.glob("*/*.*"))


def test_no_text_is_smaller_than_11_points(tmp_path):
    with matplotlib.rc_context():
        plots.use_style()
        fig, ax = panels([["a", "b"]])
        for name in ax:
            ax[name].plot([1, 2], label="KF")
            finish(ax[name], "step k", "gain")
        save_figure(fig, "a", tmp_path)
    sizes = re.findall(r"scale\(([\d.]+) -", (tmp_path / "a.svg").read_text(encoding="utf-8"))
    assert len(sizes) > 10
    assert min(map(float, sizes)) >= 0.11


@pytest.mark.parametrize(
    "change",
    [
        lambda fig, ax: ax.set_xlabel("k"),
        lambda fig, ax: ax.set_title("b", loc="left"),
        lambda fig, ax: ax.set_yscale("symlog"),
        lambda fig, ax: ax.set_ylim(0, 9),
        lambda fig, ax: ax.text(0, 0, "note"),
        lambda fig, ax: ax.legend(["line"]),
        lambda fig, ax: fig.legend(["line"]),
        lambda fig, ax: fig.suptitle("above"),
        lambda fig, ax: ax.axhline(2),
    ],
)
def test_words_scales_and_limits_are_described(change):
    assert words(change) != words(lambda fig, ax: None)


def test_rounding_is_not_described():
    fig, ax = panels([["a"]])
    y = np.array([1.0, 47.3, 0.0])
    line(ax["a"], y)
    before = describe(fig)
    ax["a"].lines[0].set_ydata(y * (1 + 4e-16) + 3e-14)
    assert describe(fig) == before


def test_a_figure_is_the_same_bytes_every_time(tmp_path):
    saved = []
    for name in ("a", "b"):
        fig, ax = panels([["a"]])
        line(ax["a"], np.arange(5.0))
        saved.append(save_figure(fig, name, folder=tmp_path))
        assert (tmp_path / f"{name}.png").read_bytes() == saved[-1].png
        svg = (tmp_path / f"{name}.svg").read_bytes()
        save_figure(fig, name, folder=tmp_path)
        assert (tmp_path / f"{name}.svg").read_bytes() == svg
    assert saved[0].png == saved[1].png
    data, metadata = saved[0]._repr_mimebundle_()
    assert set(data) == {"image/png", "text/plain"}
    assert metadata == {"image/png": {"alt": saved[0].alt}}


def test_an_svg_does_not_change_with_the_last_digits(tmp_path):
    saved, rounding = [], np.sin(np.arange(50))
    for size in (0, 1e-7):
        fig, ax = panels([["a"]])
        line(ax["a"], np.arange(50) / 7 + size * rounding)
        ax["a"].set_ylim(0, 7)
        save_figure(fig, "a", folder=tmp_path)
        saved.append((tmp_path / "a.svg").read_bytes())
    assert saved[0] == saved[1]
    assert b"dc:date" not in saved[0]


def test_an_alt_text_names_every_panel_and_curve():
    fig, ax = panels([["a", "b"]])
    for name, curve in (("a", "KF"), ("b", "LF")):
        ax[name].semilogy([1, 2], label=curve)
        finish(ax[name], "step k", f"gain {name}")
    assert alt_text(fig) == (
        "2 panels. gain a (log scale), over step k. Curves: KF. gain b (log scale), over step k. Curves: LF."
    )


@pytest.mark.parametrize(("title", "said"), [("It settles", "It settles."), ("Is it\nlate?", "Is it late?")])
def test_an_alt_text_begins_with_the_title_above_the_panels(title, said):
    fig, ax = panels([["a"]])
    finish(ax["a"], "step k", "gain")
    fig.suptitle(title)
    assert alt_text(fig) == f"{said} gain, over step k."


def test_an_alt_text_says_that_a_panel_has_no_title():
    fig, ax = panels([["a"]])
    line(ax["a"], np.arange(3.0))
    assert alt_text(fig) == "untitled panel."
    finish(ax["a"], "step k", "")
    assert alt_text(fig) == "untitled panel, over step k."


def test_a_figure_of_pyplot_is_shown_once(tmp_path):
    """As `save_figure` shows it: a notebook shows what pyplot still holds at the end of the cell."""
    from matplotlib import pyplot

    others = pyplot.get_fignums()
    fig, ax = pyplot.subplots()
    line(ax, np.arange(3.0))
    saved = save_figure(fig, "a", tmp_path)
    assert pyplot.get_fignums() == others
    assert saved.png
    line(ax, np.arange(4.0))  # it can still be drawn on and saved
    assert save_figure(fig, "a", tmp_path).png != saved.png


# How dichromats see linear RGB: Machado, Oliveira and Fernandes 2009, severity 1.
SEEN = {
    "by all": np.eye(3),
    "without red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "without green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "without blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}


def lab(linear):
    """CIE L*a*b* of linear RGB."""
    rgb_to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt(rgb_to_xyz @ np.clip(linear, 0, 1) / [0.9505, 1, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_the_colours_differ_for_colour_blind_readers_and_the_first_four_in_grey():
    rgb = np.array([to_rgb(each) for each in plots.COLOURS])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    for eyes in SEEN.values():
        seen = [lab(eyes @ each) for each in linear]
        assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 12  # some 2 can just be seen
    lightness = sorted(lab(each)[0] for each in linear[:4])
    assert np.diff(lightness).min() > 6


def test_the_last_bits_of_what_is_drawn_are_not_seen(tmp_path):
    """They differ between processors: flat ends and straight parts are where a picture would show it."""
    drawn = []
    for seed in (None, 1):
        x = np.linspace(1, 60, 400)
        y = 1 - 0.5 * np.exp(-x)
        if seed:
            y = y * (1 + 1e-15 * np.random.default_rng(seed).standard_normal(400))
        fig, ax = panels([["a", "log a"], ["b", "log b"], ["c", "d"]], height=2.5)
        for scale in ("", "log "):
            ax[f"{scale}a"].plot(x, y), ax[f"{scale}a"].fill_between(x, y - 0.1, y + 0.1)
            ax[f"{scale}b"].plot(y, x, "o")
        ax["log a"].set_yscale("log"), ax["log b"].set_xscale("log")
        ax["c"].pcolormesh(y.reshape(20, 20)), ax["d"].bar(x[:20], y[:20])
        save_figure(fig, "bits", folder=tmp_path)
        drawn.append([(tmp_path / f"bits.{kind}").read_bytes() for kind in ("png", "svg")])
    assert drawn[0] == drawn[1]


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_points_that_differ_in_their_last_bits_are_drawn_alike(scale):
    drawn = []
    for noise in (0, 1e-15 * np.random.default_rng(0).standard_normal(50)):
        y = np.geomspace(1e-9, 1, 50) * (1 + noise)
        fig, ax = panels([["a"]])
        ax["a"].set_yscale(scale)
        line(ax["a"], y)
        band(ax["a"], y)
        (settled,) = figures._settled(fig).axes
        drawn.append((settled.lines[0].get_ydata(), settled.collections[0].get_paths()[0].vertices))
    for first, second in zip(*drawn, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_an_infinite_value_leaves_the_rest_of_its_line(scale):
    fig, ax = panels([["a"]])
    (drawn,) = ax["a"].plot([1.0, 2.0, np.inf, np.nan, 5.0])
    ax["a"].set(yscale=scale, ylim=(1, 10))
    settled = figures._settled(fig).axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(settled, drawn.get_ydata(), rtol=1e-8)


def test_axes_drawn_to_scale_are_described_without_the_limits_that_fill_their_panel():
    described = set()
    for height in (2.0, 4.0):
        fig, ax = plots.panels([["a"]], height=height)
        ax["a"].plot([0.0, 1.0], [0.0, 1.0])
        ax["a"].set_aspect("equal", "datalim")
        fig.draw_without_rendering()
        described.add(figures.describe(fig))
    assert len(described) == 1
