"""A figure's description must notice what a reader would, and nothing that only a processor would."""

from itertools import combinations

import numpy as np
import pytest
from conftest import ROOT
from matplotlib import rc_params_from_file
from matplotlib.colors import to_rgb

import mpt_helpers as mpt
from mpt_helpers.figures import alt_text, coordinate, describe, draw_gaps, finish, panels, visible_gap


def line(ax, y):
    ax.plot(np.arange(len(y)), y)


def band(ax, y):
    ax.fill_between(np.arange(len(y)), y, y + 3)


def scatter(ax, y):
    ax.scatter(np.arange(len(y)), y)


def bars(ax, y):
    ax.bar(np.arange(len(y)), y)


def image(ax, y):
    ax.imshow(np.outer(y, y))


def words(change):
    fig, ax = panels([["a"]])
    line(ax["a"], np.arange(3.0))
    change(fig, ax["a"])
    return describe(fig)


@pytest.mark.parametrize("draw", [line, band, scatter, bars, image])
def test_a_change_of_one_percent_in_any_point_is_described(draw):
    y = np.random.default_rng(0).uniform(1, 100, 20)
    described = set()
    for i in range(-1, len(y)):
        moved = y.copy()
        if i >= 0:
            moved[i] *= 1.01
        fig, ax = panels([["a"]])
        draw(ax["a"], moved)
        described.add(describe(fig))
    assert len(described) == len(y) + 1


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


def test_a_gap_that_leaves_the_level_of_rounding_is_described():
    described = []
    for gap in (1e-16, 2e-12, 9e-10):
        fig, ax = panels([["gap"]])
        draw_gaps(ax["gap"], {"KF - LF": np.full(9, gap)})
        described.append(describe(fig))
    assert len(set(described)) == 3


def test_gaps_are_clipped_where_rounding_begins():
    np.testing.assert_array_equal(visible_gap([0, 1e-17, 5e-13]), 1e-12)
    np.testing.assert_allclose(visible_gap([3.33333e-11, 0.123456]), [3e-11, 0.123], rtol=1e-14)
    _, ax = panels([["gap"]])
    draw_gaps(ax["gap"], {"a": np.array([[1e-3, 2e-3], [1e-16, 0]])})
    np.testing.assert_allclose(ax["gap"].lines[0].get_ydata(), [2e-3, 1e-12])


def test_a_figure_is_the_same_bytes_every_time(tmp_path):
    saved = []
    for name in ("a", "b"):
        fig, ax = panels([["a"]])
        line(ax["a"], np.arange(5.0))
        saved.append(mpt.save_figure(fig, name, folder=tmp_path))
        assert (tmp_path / f"{name}.png").read_bytes() == saved[-1].png
        svg = (tmp_path / f"{name}.svg").read_bytes()
        mpt.save_figure(fig, name, folder=tmp_path)
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
        mpt.save_figure(fig, "a", folder=tmp_path)
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
    colours = rc_params_from_file(ROOT / "notebooks" / "matplotlibrc", use_default_template=False)["axes.prop_cycle"]
    rgb = np.array([to_rgb(each["color"]) for each in colours])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    for eyes in SEEN.values():
        seen = [lab(eyes @ each) for each in linear]
        assert min(np.linalg.norm(a - b) for a, b in combinations(seen, 2)) > 12  # some 2 can just be seen
    lightness = sorted(lab(each)[0] for each in linear[:4])
    assert np.diff(lightness).min() > 6


def test_a_figure_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_bytes(b"old")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        mpt.save_figure(panels([["a"]])[0], "a", folder=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert (tmp_path / "a.png").read_bytes() == b"old"


def test_a_coordinate_is_drawn_where_it_was_estimated():
    t, truth = np.arange(5.0), np.column_stack([np.arange(5.0), np.ones(5), np.full(5, 2.0)])
    estimates = {"filter": truth[2:] + 0.5, "line": truth[1:, :2] - 0.25}
    fig = coordinate(t, truth, t, estimates, sigma=np.ones((3, 3)))
    drawn = {ax.get_title(loc="left"): {line.get_label(): line.get_xydata() for line in ax.lines} for ax in fig.axes}
    assert list(drawn) == ["position (m)", "position error (m)", "velocity (m/s)", "constant error of the INS (m/s)"]
    np.testing.assert_array_equal(drawn["position (m)"]["filter"], np.column_stack([t[2:], t[2:] + 0.5]))
    np.testing.assert_array_equal(drawn["position error (m)"]["line"], np.column_stack([t[1:], np.full(4, -0.25)]))
    np.testing.assert_array_equal(drawn["velocity (m/s)"]["line"], np.column_stack([t[1:], np.full(4, 0.75)]))
    assert set(drawn["constant error of the INS (m/s)"]) == {"true", "filter"}


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_the_last_bits_of_what_is_drawn_are_not_seen(tmp_path, scale):
    """They differ between processors: flat ends and straight parts are where a picture would show it."""
    drawn = []
    for seed in (None, 1, 2):
        x = np.linspace(1, 60, 400)
        y = 1 - 0.5 * np.exp(-x)
        if seed:
            y = y * (1 + 1e-15 * np.random.default_rng(seed).standard_normal(400))
        fig, ax = panels([["a", "b"]], height=2.5)
        ax["a"].plot(x, y), ax["a"].fill_between(x, y - 0.1, y + 0.1)
        ax["b"].plot(y, x, "o")
        ax["a"].set_yscale(scale), ax["b"].set_xscale(scale)
        mpt.save_figure(fig, "bits", folder=tmp_path)
        drawn.append([(tmp_path / f"bits.{kind}").read_bytes() for kind in ("png", "svg")])
    assert drawn[0] == drawn[1] == drawn[2]
