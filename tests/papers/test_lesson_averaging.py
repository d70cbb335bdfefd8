"""The lesson on averaging: what it teaches agrees with the package, and each number of its prose is computed here."""

import re
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose, shown, source
from scipy.signal import lfilter

import mpt_helpers as mpt
from reproduction.lasting import fit_lasting, lasting_error
from reproduction.paper_2007 import lesson_averaging as lesson
from reproduction.paper_2007 import positioning, recorded

sys.path.insert(0, str(ROOT / "notebooks" / "data"))
import make_table

CELLS = {cell["id"]: cell for cell in cells_of(ROOT / "notebooks" / "lessons" / "what_averaging_leaves.ipynb")}
TEXT = re.sub(r"\s+", " ", prose(CELLS.values()).replace("*", ""))
ONE, TWO = recorded.KINDS
WALL = f"NYA1, {TWO}"


def says(text):
    """Require that the lesson says this; numbers in it are computed by the test."""
    assert re.sub(r"\s+", " ", text) in TEXT, text


def printed(name):
    """What a cell of the lesson prints or shows."""
    return shown(CELLS[name])


def row(name, start):
    """The numbers in a row of a table that a cell shows."""
    (line,) = [each for each in printed(name).splitlines() if each.startswith(start)]
    return [float(each) for each in re.findall(r"-?\d+\.?\d*", line[len(start) :])]


def constants_of_heights():
    """The constants r, sigma and tau (s) of each recording's height, as the lesson shows them."""
    found = {}
    for station in recorded.TABLES:
        for kind in recorded.KINDS:
            _, sigma, noise, tau = row("heights", f"{station}, {kind}")
            found[f"{station}, {kind}"] = noise**2, sigma, 60 * tau
    return found


@pytest.fixture(scope="module")
def days():
    return recorded.recorded_days()


@pytest.fixture(scope="module")
def cases():
    return lesson.cases()


@pytest.fixture(scope="module")
def taught():
    """The functions that the lesson defines."""
    names = {"np": np}
    exec(source(CELLS["kalman"]).partition("\n\n\nstretches =")[0], names)
    exec(source(CELLS["hatch"]), names)
    return names


@pytest.fixture(scope="module")
def hatch(taught):
    return taught["hatch"]


# Numbers that no cell prints: computed in tests below.
COMPUTED = """0.05 0.1 0.15 0.2 0.23 0.25 0.3 0.4 0.78 0.8 0.82 0.83 0.84 0.9 0.91 0.93 0.94 0.97 1.0 1.07 1.1 1.2
1.26 1.3 1.4 1.42 1.5 1.56 1.7 1.9 2.0 2.1 2.20 2.46 3.3 4.7"""


def test_numbers_with_decimals_are_printed_by_cells_or_computed_in_a_test():
    out = "\n".join(shown(cell) for cell in CELLS.values() if cell["cell_type"] == "code")
    for number in set(re.findall(r"(?<![\d.])\d+\.\d+(?![\d.])", TEXT)):
        as_it_is = re.search(rf"(?<![\d.]){re.escape(number)}(?!\d)", out)
        assert as_it_is or number in COMPUTED.split(), number
    assert all(number in TEXT for number in COMPUTED.split())


# The mean


def test_the_question_of_the_first_line_is_answered(cases):
    up = cases[WALL].errors[:2800, 2]
    means = up.reshape(28, 100).mean(axis=1)
    one, made = np.std(cases[WALL].errors[:, 2]), mpt.metrics.rms(means)
    assert 2.4 < one < 2.6
    says("Each one is wrong by two and a half metres or so")
    assert f"{one / 10:.2f}" == "0.25"
    says("some nineteen of their means should be within 0.25 m of the mean of the day. Four were")
    assert round(28 * 0.6827) == 19
    assert np.sum(np.abs(means) < 0.25) == 4
    says(f"typically (rms) they were {made:.2f} m off")
    stated = lesson.stated_at_rest(4.7, 1.1, 2700.0, 3000.0, 100)
    says(f"With 7 % for the plain mean it is {stated:.2f} m, a standard deviation. The 28 means were {made:.2f} m off.")
    says(f"with the largest of these constants to $\\sqrt{{{stated:.2f}^2 + 1.2^2}}$ = {np.hypot(stated, 1.2):.1f} m")
    from_header = mpt.metrics.rms(means + cases[WALL].offset[2])
    says(f"from NYA1's header the 28 means were {from_header:.1f} m off")


def test_the_parts_of_the_walls_error(cases):
    case = cases[WALL]
    one, noise, lasting = (np.std(each[:, 2]) for each in (case.errors, case.noise, case.lasting))
    says(f"one fix is {one:.2f} m off, its noise is {noise:.2f} m and its lasting error {lasting:.2f} m")
    assert np.hypot(noise, lasting) == pytest.approx(one, rel=0.05)
    says(f"The carrier phase, which the fit never saw, had {lasting:.2f} m for σ")
    says("at the price of about three times the noise")
    for name in recorded.TABLES:
        sizes = [recorded.size(cases[f"{name}, {kind}"].noise) for kind in recorded.KINDS]
        assert 2.5 < sizes[1] / sizes[0] < 3.5


def test_the_formula_is_computed_by_hand():
    says(f"$1 + 50/120$, or {1 + 50 / 120:.2f}")
    R = np.exp(-np.abs(np.subtract.outer(np.arange(100), np.arange(100))) * 30 / 3600)
    best = 1 / np.sqrt(np.linalg.inv(R).sum())
    assert f"{best:.2f}" == f"{1 / np.sqrt(1.42):.2f}"
    says(f"leaves $1/\\sqrt{{1.42}}$, or {best:.2f} of the lasting error")
    count = 1 + 50 / 90
    wave, noise = 1.1**2 / count, 4.7 / 100
    says(f"$1 + 50/90$ = {count:.2f} different errors")
    says(f"1.1²/1.56 = {wave:.2f} m². The noise leaves 4.7/100 = {noise:.2f} m².")
    says(f"Together that is {wave + noise:.2f} m², and its root is {np.sqrt(wave + noise):.2f} m")
    says(f"In the picture that we use, {100 * np.exp(-1):.0f} % of it is left after a time τ")
    says("something new has come, nearly as large as σ")
    assert np.sqrt(1 - np.exp(-2)) == pytest.approx(0.93, abs=0.005)


def test_the_root_of_n_ends_where_the_noise_is_as_large_as_what_lasts(cases):
    r, sigma, _ = constants_of_heights()[WALL]
    says("After about $r/\\sigma^2$ fixes the noise that is left is as large as σ, and more fixes gain little.")
    says("On your wall that is four fixes")
    assert round(r / sigma**2) == 4
    made = mpt.metrics.rms(cases[WALL].errors[:2880, 2].reshape(-1, 4).mean(axis=1))
    assert made == pytest.approx(np.hypot(sigma, np.sqrt(r / 4)), rel=0.1)
    says("A phone with 10 m of noise each second and your wall's lasting error would have some eighty")
    assert 75 < 100 / sigma**2 < 85
    hour = lesson.stated_at_rest(100.0, 1.1, 2700.0, 3600.0, 3600)
    says(f"Its mean of an hour is {hour:.1f} m off, where $\\sqrt n$ says {10 / np.sqrt(3600):.1f}")


def test_the_mean_leaves_seven_percent_more_than_the_best_average():
    """Of errors that fade as e^(-x) over a span x, in units of tau: the closed forms of both."""
    says("The plain mean leaves at most 7 % more")
    x = np.linspace(0.01, 50, 5000)
    ratio = np.sqrt(2 * (x - 1 + np.exp(-x)) / x**2 * (1 + x / 2))
    assert 1.06 < ratio.max() < 1.07
    R = np.exp(-np.abs(np.subtract.outer(np.arange(300), np.arange(300))) * 3 / 300)  # a span of three tau
    assert np.sqrt(R.mean() * np.linalg.inv(R).sum()) == pytest.approx(ratio[np.abs(x - 3).argmin()], abs=2e-3)


def test_the_filter_has_what_the_fit_says():
    day = re.findall(r"(?m)^(?:r|sigma|tau) ([\d.]+)", printed("fit"))
    r, sigma, tau = float(day[0]), float(day[1]), 60 * float(day[2])
    assert f'"r": {r:.1f}, "sigma": {sigma:.1f}, "tau": {tau:.1f}' in source(CELLS["kalman"])


def test_noise_falls_nearly_as_theory_says_and_most_of_what_lasts_stays(cases):
    says("The noise falls to 0.1 to 0.2 of itself, where theory says 0.1 (dotted)")
    noise = [lesson.left_by_mean(case.noise, 100) for case in cases.values()]
    assert 0.1 < min(noise) < max(noise) < 0.2
    lasting = lesson.spread([lesson.left_by_mean(case.lasting, 100) for case in cases.values()])
    says(f"Of the lasting error a hundred fixes leave {lasting}")


def test_what_a_mean_leaves_is_that_of_memory(cases):
    for row, case in zip(lesson.memories(cases), cases.values(), strict=True):
        assert row[1] == f"{lesson.left_by_mean(case.errors, 100):.2f}"


def test_what_is_left_without_noise_jumps_where_satellites_come_and_go(days, cases):
    says("The line jumps where a satellite comes or goes")
    for name, day in days.items():
        arc = recorded.arcs(day)
        changes = (arc[1:] != arc[:-1]).any(axis=1)
        jumps = np.abs(np.diff(cases[f"{name}, {TWO}"].lasting[:, 2])) > 0.5
        assert jumps.sum() > 20
        assert changes[jumps].mean() > 0.75 > 0.2 > changes.mean()


def test_how_well_the_formula_and_its_constants_do_is_said():
    says("Fitted to the same day, the formula was right within a quarter on all 18 axes")
    shown = np.reshape(
        [row("carried", each) for each in ("the same day", "its other half", "another station")], (3, 2, 3)
    )
    same, half, station = shown
    assert 0.75 < 1 / same.max() < 1 / same.min() <= 1.25
    says("By constants of the other half of the day it was off by up to a factor of five")
    assert round(max(half.max(), 1 / half.min())) == 5
    says("by another station's a mean was up to three times further off than stated")
    assert round(station.max()) == 3
    says(
        "Over four hours the height at Belem with two frequencies, whose τ the day does not determine, was twice as far"
    )
    says("off as stated, and no other axis more than 1.2 times.")
    long = re.search(r"Belem, two frequencies, up: ([\d.]+); all others at most ([\d.]+)", printed("carried"))
    first, second = map(float, long.groups())
    assert first == pytest.approx(2, abs=0.1)
    assert second < 1.2


def test_the_formula_at_rest_is_judged_on_errors_of_a_known_kind():
    """Errors three times as large in the second half, and at the second station."""
    rng, cases, filtered = np.random.default_rng(14), {}, {}
    for station, first, second in (("a", 1.0, 3.0), ("b", 3.0, 3.0)):
        halves, constants = [], []
        for size in (first, second):
            model = recorded.with_lasting(30.0, 4.0 * size**2, size, 2700.0).model
            x, z = mpt.simulate(model, 100, rng, tracks=400)
            halves.append((z - x[:, :1])[:, 0].T.ravel())
            constants.append([[4.0 * size**2, size, 2700.0]])
        for kind in recorded.KINDS:
            cases[f"{station}, {kind}"] = SimpleNamespace(kind=kind, step=30.0, errors=np.concatenate(halves)[:, None])
            r, sigma, tau = np.transpose(constants[0])
            fit = SimpleNamespace(r=r, sigma=sigma, tau=tau, halves=np.array(constants))
            filtered[f"{station}, {kind}"] = SimpleNamespace(fit=fit)

    def made(pairs):
        return [lesson.made_at_rest(*pair, 30.0)[0] for pair in pairs]

    of_one = {name: cases[name] for name in cases if cases[name].kind == ONE}
    # 400 windows scatter by 3.5 %; the mean leaves 1.06 of the best average, and 1.07 is stated.
    np.testing.assert_allclose(made(lesson.same_day(of_one, filtered)), [np.sqrt(5), 1.0], rtol=0.12)
    np.testing.assert_allclose(made(lesson.other_half(of_one, filtered)), [1 / 3, 3.0, 1.0, 1.0], rtol=0.12)
    others = lesson.another_station(cases, filtered)
    assert len(others) == 4  # of the same kind only
    np.testing.assert_allclose(made(others)[:2], [np.sqrt(5) / 3, np.sqrt(5) / 3], rtol=0.12)
    _, half, _ = lesson.carried(cases, filtered)
    of_table = [float(each) for each in re.findall(r"[\d.]+", half[1])]
    np.testing.assert_allclose(of_table, [1.0, 1 / 3, 3.0], rtol=0.12)


def test_a_tau_that_the_day_does_not_determine_has_a_question_mark():
    case = SimpleNamespace(lasting=np.zeros((5, 3)))
    for high, mark in ((6.9, ""), (7.3, "?")):  # e^1.96 = 7.1
        known = {"tau": 600 * np.array([[1, 1], [1, 1], [1, high]])}
        fit = SimpleNamespace(known=known, sigma=np.ones(3), r=np.ones(3), tau=600 * np.ones(3))
        ((*_, tau),) = lesson.heights({"a": case}, {"a": SimpleNamespace(fit=fit)})
        assert tau == f"10{mark}"


def test_two_hours_of_a_fix_a_second_are_no_substitute_for_a_day():
    """An error of 1.1 m that lasts 45 minutes, and reflections of 2.2 m that last 20 s: the fit finds these."""
    says("The log: a fix a second for two hours is no substitute for a day")
    rng, fades = np.random.default_rng(0), np.exp([-1 / 20, -1 / 2700])
    reflections, lasting = (
        lfilter([np.sqrt(1 - keep**2)], [1, -keep], size * rng.standard_normal(20_000))[-7200:]
        for keep, size in zip(fades, (np.sqrt(4.7), 1.1), strict=True)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        short = fit_lasting((np.arange(7200.0), reflections + lasting))
    assert short.tau[0] < 60
    assert short.sigma[0] > 1.8


# The filter


def test_the_filter_that_is_taught_is_that_of_the_package(taught):
    """On a track that moves, whose first fixes are missing; without what lasts the state is there and stays zero."""
    axis = mpt.constant_velocity(30.0, 1e-3, 4.0, P0=np.diag([100.0, 400.0]))
    _, z = mpt.simulate(lasting_error(axis, 1.5, 1800.0), 60, np.random.default_rng(11))
    z[[0, 1, 30]] = np.nan
    z = z[:, 0]
    for model, constants in ((lasting_error(axis, 1.5, 1800.0), {"sigma": 1.5, "tau": 1800.0}), (axis, {})):
        made = list(taught["kalman"](z, 30.0, 4.0, **constants, q=1e-3, speed=20.0))
        theirs = mpt.KalmanFilter(model).estimates((z - z[2])[:, None])
        n = model.n
        np.testing.assert_allclose([x[:n] - np.eye(n)[0] * z[2] for x, _ in made], theirs.x, atol=1e-8)
        np.testing.assert_allclose([P[:n, :n] for _, P in made], theirs.P, atol=1e-8)
        assert all(np.all(x[n:] == 0) and np.all(P[n:] == 0) for x, P in made)


def test_what_the_filters_state_and_make_is_read(cases, taught):
    shown = re.findall(r"states ([\d.]+) m, makes ([\d.]+) m", printed("kalman"))
    (mean, by_mean), _, (told, by_told), (state, _) = shown
    assert (mean, by_mean) == ("0.25", "0.94")
    says("The first line is the mean, with the $\\sqrt n$ of the textbook")
    z = cases[WALL].errors[:100, 2]
    *_, (x, _) = taught["kalman"](z, 30.0, 2.46**2, speed=0.0)
    assert x[0] == pytest.approx(z.mean(), abs=0.01)
    says("(third line), is as good as the mean, and states what it makes")
    assert float(by_told) == pytest.approx(float(told), rel=0.05)
    assert float(by_told) < float(by_mean)
    p, e, both = re.search(
        r"position to ([\d.]+) m, its error to ([\d.]+) m, their sum to ([\d.]+)", printed("kalman")
    ).groups()
    says(f"The sum is known to {both} m. Of its parts, the error is known to {e} m, no better than at the start")
    says(f"and the position to {p} m")
    assert p == state


def test_what_the_table_of_filters_says_is_said():
    least, most = row("judged", "white")[2:4]
    assert (round(least), round(most)) == (2, 6)
    says("At rest white was two to six times too sure after 50 min")
    says("The longer white runs, the more it is too sure")
    least, most = np.reshape(row("judged", "white"), (-1, 2)).T
    assert (np.diff(least) > 0).all()
    assert (np.diff(most) > 0).all()
    nis = re.search(r"NIS of tuned: (.*)", printed("judged")).group(1)
    says(f"passes NIS all the same: the square of a surprise over its stated variance is {nis}, where it should be 1")
    least, most = map(int, re.search(r"against white: (\S+) to (\S+) %", printed("judged")).groups())
    assert -15 < least < most < 5
    says("aware comes hardly nearer")


def test_the_more_one_turns_the_less_the_lasting_error_matters(cases):
    """Walkers are simulated, errors recorded; the filter that does not know of what lasts is judged in space."""
    q, step = 0.1, 30.0
    start = np.diag([100.0, 1.0])
    walks, _ = mpt.simulate(mpt.constant_velocity(step, q, 1.0, P0=start), 100, np.random.default_rng(0), tracks=280)
    for name, case in cases.items():
        ends = []
        for axis in case.errors.T:
            errors = np.tile(recorded.windows(axis), 10)
            white = mpt.KalmanFilter(mpt.constant_velocity(step, q, np.var(axis), P0=start))
            found = white.estimates(walks[:, :1] + errors)
            made = (found.x[:, 0] - walks[:, 0])[20:]
            ends.append([mpt.metrics.rms(made.ravel()), np.sqrt(found.P[20:, 0, 0].mean()), np.std(errors[20:])])
        made, stated, fix = np.linalg.norm(ends, axis=0)
        assert made / stated == pytest.approx(1.0, abs=0.03)
        assert made / fix == pytest.approx(1.0, abs=0.01)
        r, sigma, tau = constants_of_heights()[name]
        model = lasting_error(mpt.constant_velocity(step, q, r, P0=start), sigma, tau)
        found = mpt.KalmanFilter(model).estimates(walks[:, :1] + errors)
        assert np.std((found.x[:, 0] - walks[:, 0])[20:]) > 0.97 * np.std(errors[20:])
    says("Simulated walkers ($q$ = 0.1 m²/s³) made 1.0 times what white stated with a fix each 30 s")
    says("where no filter gained on a fix")


def test_with_a_fix_each_second_it_matters_more():
    """Exact: the covariance of the error that the filter makes where r, sigma and tau are those of the heights."""
    dt, q, found = 1.0, 0.1, []
    for r, sigma, tau in constants_of_heights().values():
        kf = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt, q, r + sigma**2))
        K, a = kf.B[:, 0], np.exp(-dt / tau)
        # The error of position and velocity, and e: e_x = A e_x + (I - K H) w - K (a e + new + v)
        A = np.block([[kf.A, -a * K[:, None]], [np.zeros((1, 2)), a]])
        reaches = np.eye(2) - np.outer(K, [1.0, 0.0])
        model = mpt.constant_velocity(dt, q, 1.0)
        noise = np.zeros((3, 3))
        noise[:2, :2] = reaches @ model.Q @ reaches.T + r * np.outer(K, K)
        new = np.append(-K, 1.0)
        noise += sigma**2 * (1 - a**2) * np.outer(new, new)
        P = np.linalg.solve(np.eye(9) - np.kron(A, A), noise.ravel()).reshape(3, 3)
        found.append(np.sqrt(P[0, 0] / kf.P[0, 0]))
    says(f"and {lesson.spread(found, '{:.1f}')} times with a fix each second")


def test_a_change_is_that_of_the_error_in_space():
    def of(*last):
        return [SimpleNamespace(error=[9.0, each]) for each in last]

    found = lesson.changed({"a": SimpleNamespace(aware=of(2, 3, 6), white=of(0, 6, 8))}, "aware", "white")
    np.testing.assert_allclose(found, [-30.0])


def test_the_rule_for_q_is_what_it_says():
    says("1.4²/20, about 0.1 m²/s³")
    assert pytest.approx(0.1, abs=0.005) == 1.4**2 / 20
    wander = np.random.default_rng(3).standard_normal((20_000, 20)).cumsum(axis=1) * np.sqrt(0.1)  # 1 s each
    assert wander[:, -1].std() == pytest.approx(1.4, rel=0.03)


# Smoothing


def reference(code, phase, arc, most):
    """Smooth ranges (N, m), whose phase has another constant in each arc: with arrays, all satellites at once."""
    offset, count, ranges = np.zeros(code.shape[1]), np.zeros(code.shape[1]), code.copy()
    for k, here in enumerate(arc):
        goes_on = (here >= 0) & (here == arc[k - 1]) if k else np.zeros(len(here), dtype=bool)
        count = np.where(goes_on, np.minimum(count + 1, most), 1)
        gap = code[k] - phase[k] - offset
        offset = np.where(goes_on, offset + gap / count, code[k] - phase[k])
        ranges[k] = np.where(here >= 0, phase[k] + offset, code[k])
    return ranges


def test_the_smoothing_of_the_table_is_that_of_arcs(days, cases, hatch):
    """Another program, by the numbers of the arcs: the fixes of a day of two frequencies."""
    day, case = days["NYA1"], cases[WALL]
    code, arc = case.ranges, np.where(np.isfinite(case.ranges), recorded.arcs(day), -1)
    ranges = reference(code, np.where(arc >= 0, code + recorded.carrier(day, TWO), 0.0), arc, 10)
    theirs = recorded.about_mean(recorded.fixes(day, ranges).local)
    found = lesson.smoothed({WALL: case}, hatch)
    np.testing.assert_allclose(found[WALL], theirs, rtol=0, atol=1e-5)


def test_the_table_is_made_by_the_filter_that_is_printed(cases):
    """A filter that returns the code leaves the fixes as they are."""
    name = "ESBC, one frequency"
    found = lesson.smoothed({name: cases[name]}, lambda code, phase, anew, n, slip: code)
    np.testing.assert_allclose(found[name], recorded.about_mean(cases[name].errors), rtol=0, atol=1e-6)
    assert "smooth = lesson.smoothed(cases, hatch)" in source(CELLS["remedies"])


def test_smoothing_is_a_mean_at_first_and_then_forgets(hatch):
    rng = np.random.default_rng(4)
    phase = 1e3 * rng.standard_normal(40).cumsum()
    noise = rng.standard_normal(40)
    found = hatch(phase + 5 + noise, phase, np.arange(40) == 25, n=10) - phase - 5
    for k in (0, 4, 9, 25, 30):  # until ten epochs are in it: their mean
        start = 0 if k < 25 else 25
        np.testing.assert_allclose(found[k], noise[start : k + 1].mean(), atol=1e-9)
    np.testing.assert_allclose(found[15], found[14] + (noise[15] - found[14]) / 10, atol=1e-9)
    says(f"and such a mean keeps $\\sqrt{{0.1/1.9}}$, or {np.sqrt(0.1 / 1.9):.2f}, of its noise")


@pytest.mark.parametrize("missing", ["code", "phase"])
def test_smoothing_begins_anew_after_what_is_missing(hatch, missing):
    """With a slip inside the gap: a filter that goes on through it is wrong by as much."""
    true = 2.1e7 + 400.0 * np.arange(600)
    code = true + 0.5 * np.random.default_rng(1).standard_normal(600)
    phase = true + 12.3 + np.where(np.arange(600) >= 350, 8.0, 0.0)
    {"code": code, "phase": phase}[missing][345:355] = np.nan
    smooth = hatch(code, phase, np.zeros(600, dtype=bool), n=10)
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(code + phase))
    for k in (355, 359, 364):
        assert smooth[k] - phase[k] == pytest.approx(np.mean((code - phase)[355 : k + 1]))


def test_one_frequency_is_smoothed_with_its_own_phase_only(days, cases, hatch, monkeypatch):
    """The second phase has no say, and without any phase the code stays."""
    says(f"here by more than {recorded.SLIP} m in 30 s")
    says("With one phase stop at 100 s")
    name = f"NYA1, {ONE}"
    found = lesson.smoothed({name: cases[name]}, hatch)[name]
    nothing = np.full((2880, 32), np.nan)
    day = days["NYA1"]._replace(phase2=nothing)
    assert recorded.to_smooth(day, ONE, cases[name].ranges)[2] * day.step == pytest.approx(100, abs=15)
    for phase1, expected in ((day.phase1, found), (nothing, cases[name].errors)):
        one = day._replace(phase1=phase1)
        monkeypatch.setattr(recorded, "recorded_days", lambda tables=None, one=one: {"NYA1": one})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # no phase has no median step
            np.testing.assert_allclose(lesson.smoothed({name: cases[name]}, hatch)[name], expected, atol=1e-6)


def test_what_smoothing_takes_off():
    rows = {name: row("remedies", name) for name in constants_of_heights()}
    took = {kind: [100 * (1 - rows[n][1] / rows[n][0]) for n in rows if n.endswith(kind)] for kind in (ONE, TWO)}
    one, two = (lesson.spread(took[kind], "{:.0f}") for kind in (ONE, TWO))
    says(f"It took {two} % off the error of a fix with two frequencies, and {one} % with one")
    better = [100 * (1 - mean / smoothed) for _, smoothed, mean in rows.values()]
    says(f"If you stand still for 50 min, the mean is better, by {min(better):.0f} to {max(better):.0f} %")


def test_with_two_phases_a_longer_average_takes_more_off(cases, hatch):
    longer = {}
    for station in recorded.TABLES:
        name = f"{station}, {TWO}"
        sizes = []
        for n in (10, 60):
            smooth = lesson.smoothed({name: cases[name]}, lambda *each, n=n: hatch(*each[:3], n))
            sizes.append(recorded.size(smooth[name][99:]))
        longer[station] = 100 * (1 - sizes[1] / sizes[0])
    most = max(longer, key=longer.get)
    says(f"30 min took up to {longer[most]:.0f} % more off ({most}) than the 5 min of the table, and nothing at NYA1")
    assert abs(longer["NYA1"]) < 2


def test_six_times_the_median_begins_anew_too_often(cases, hatch):
    says("take twelve times the median step of code minus phase")
    for station in recorded.TABLES:
        name = f"{station}, {ONE}"
        six, twelve = (
            recorded.size(lesson.smoothed({name: cases[name]}, hatch, times=times)[name][99:])
            for times in (6, lesson.SLIP_STEPS)
        )
        assert f"{twelve:.2f}" == f"{row('remedies', name)[1]:.2f}"
        assert twelve < six
    assert lesson.SLIP_STEPS == 12


def test_a_slip_that_code_minus_phase_shows_is_found(hatch):
    true = 2.1e7 + 400.0 * np.arange(600)
    code = true + 0.5 * np.random.default_rng(1).standard_normal(600)
    phase = true + 12.3 + np.where(np.arange(600) >= 350, 20.0, 0.0)
    never = np.zeros(600, dtype=bool)
    slip = 12 * np.median(np.abs(np.diff(code - phase)))
    assert np.abs(hatch(code, phase, never, 10, slip) - true).max() < 2
    assert np.abs(hatch(code, phase, never, 10) - true).max() > 15


# What can be corrected, and the truth


def test_what_the_biases_did_is_said(days, cases):
    before = [
        recorded.size(recorded.case(name, recorded.without_biases(day), TWO).lasting) for name, day in days.items()
    ]
    after = [recorded.size(cases[f"{name}, {TWO}"].lasting) for name in days]
    was, now = (lesson.spread(each, "{:.1f}") for each in (before, after))
    was, now = was.replace(" to ", "–"), now.replace(" to ", "–")
    says(f"with two frequencies the lasting error, in space, fell from {was} m to {now} m")
    larger = np.divide(before, after)
    assert 1.45 < larger.min() < larger.max() < 1.55
    assert "the error that lasts was half as large again at three stations" in (ROOT / "docs/rinex.md").read_text(
        "utf-8"
    )


def test_the_vapour_of_the_tropics(cases):
    """The delay is that of an integral through the model's air; what the tables have is of their script."""
    heights = np.linspace(0, 20_000, 40_001)
    warm = lesson.WARM - lesson.LAPSE * heights
    # Vapour falls as pressure does, to the power of EXPONENT + 1.
    fall = (warm / lesson.WARM) ** (9.80665 / (lesson.GAS * lesson.LAPSE) * (lesson.EXPONENT + 1))
    column = np.trapezoid(1e-6 * lesson.REFRACTION * lesson.VAPOUR * fall / warm**2, heights)
    assert lesson.wet_delay() == pytest.approx(column, rel=0.01)  # 9.784 is gravity of the column's mean, 9.807 below
    dry = 0.0022768 * 1013.25 * (1 - 2.2557e-5 * 9) ** 5.2568
    assert make_table.saastamoinen(9.0, 90.0) - dry == pytest.approx(0.085, abs=0.001)
    one, two = (cases[f"Belem, {kind}"] for kind in recorded.KINDS)
    changed = [f"{case.offset[2] - lesson.in_the_tropics(case)[2]:.1f}" for case in (one, two)]
    assert changed == ["0.8", "0.8"]
    says("Of Belem's, 0.8 m is the vapour of the tropics")
    says("A model of vapour by latitude and season (UNB3, MOPS) takes the 0.8 m off Belem's height")


def test_the_mean_of_the_day_is_that_of_the_header(cases):
    two = {name: cases[f"{name}, {TWO}"].offset for name in recorded.TABLES}
    esbc, nya1, belem = (f"{abs(two[name][2]):.1f}" for name in ("ESBC", "NYA1", "Belem"))
    assert esbc == nya1
    one = max(abs(cases[f"{name}, {ONE}"].offset[2]) for name in recorded.TABLES)
    where = f"was {esbc} m from there at ESBC and NYA1 and {belem} m at Belem with two frequencies"
    says(f"{where}, and up to {one:.1f} m with one")
    says(f"In height that was up to {belem} m here with two frequencies, and {one:.1f} m with one")


def test_plates_have_moved_sideways(days, cases):
    """By ITRF2014's rotations of Eurasia and South America (Altamimi et al. 2017), since ETRS89 and SIRGAS2000."""
    eurasia, america = (-0.085, -0.531, 0.770), (-0.270, -0.301, -0.140)  # milliarcseconds a year
    moved = {
        "ESBC": (eurasia, 2020.5 - 1989.0),
        "NYA1": (eurasia, 2024.3 - 1989.0),
        "Belem": (america, 2024.0 - 2000.4),
    }
    shifts = []
    for name, (pole, years) in moved.items():
        station = days[name].station
        velocity = np.cross(np.radians(np.array(pole) / 3.6e6), station)
        shifts.append(years * positioning.local_axes(station) @ velocity)
    sizes = lesson.spread(np.linalg.norm(shifts, axis=1), "{:.1f}")
    says(f"Plates have moved since by {sizes} m, and the means of two frequencies agree, but that is sideways")
    assert np.abs(shifts)[:, 2].max() < 0.01
    # Such frames are an inference from this agreement: on six axes together it is 0.2 m.
    apart = [cases[f"{name}, {TWO}"].offset[:2] - shift[:2] for name, shift in zip(moved, shifts, strict=True)]
    assert np.linalg.norm(apart) < 0.25 < 0.9 < np.linalg.norm(shifts)
