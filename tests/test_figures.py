"""A figure's description must notice what a reader would, and nothing that only a processor would."""

import numpy as np
import pytest

import mpt_helpers as mpt
from mpt_helpers.figures import coordinate, describe, draw_gaps, panels, visible_gap


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
    assert saved[0].png == saved[1].png
    assert set(saved[0]._repr_mimebundle_()) == {"image/png", "text/plain"}


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
