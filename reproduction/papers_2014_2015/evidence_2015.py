"""What is found of the claims of 2015, for its notebook: {id: (whether it holds, evidence[, what lies beyond])}."""

import numpy as np

import mpt_helpers as mpt
from reproduction import burden
from reproduction.ledger import gap_text

from .checks_2014 import below, closeness, forgets_its_start, gap, stated

WALK = 1.5  # m/s
FILTERS = ("KF", "LF", "JKLF", "SSKF", "SSLF", "JSSKLF")
INVARIANT, STEADY = FILTERS[:3], FILTERS[3:]


def rounding(size):
    """Say whether a gap is rounding, and how large it is."""
    return size < 1e-12, f"largest gap {gap_text(size)}"


def unmeasured(axis, steps):
    """Return sigma of the position of a settled axis after 0 ... steps steps without a measurement, in metres.

    >>> unmeasured(mpt.gsm_axis(dt=1.0, q=0.01, r=0.1), 30)[[0, 30]].round(2)
    array([ 0.17, 10.09])
    """
    P = mpt.SteadyStateFilter.from_kalman(axis).P
    sigma = [np.sqrt(P[0, 0])]
    for _ in range(steps):
        P = axis.F @ P @ axis.F.T + axis.Q
        sigma.append(np.sqrt(P[0, 0]))
    return np.array(sigma)


def late(axis):
    """Return how far a constant gain is behind a walker whose present positions are its measurements, in metres.

    >>> round(late(mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)), 6)
    1.5
    """
    walk = WALK * np.arange(1.0, 101)[:, None]  # without noise
    return float(walk[-1, 0] - mpt.SteadyStateFilter.from_kalman(axis).filter(walk)[-1, 0])


def introduction(axis):
    """Section 1: without measurements of one of three axes, P does not forget whether it began at 0 or at 100 I."""
    three = mpt.stack(axis, axis, axis)
    as_said = []
    for left_out in (None, 0, 1, 2):
        H = np.array([0 * row if i == left_out else row for i, row in enumerate(three.H)])
        starts = [mpt.LinearModel(F=three.F, H=H, Q=three.Q, R=three.R, P0=p0 * np.eye(6)) for p0 in (0, 100)]
        settles = gap(*(mpt.KalmanFilter(start).covariances(400)[-1] for start in starts)) < 1e-12
        as_said.append(settles == (left_out is None))
    sigma = unmeasured(axis, 30)
    lost = f"30 steps without measurements take σ of a position from {sigma[0]:.2f} m to {sigma[30]:.1f} m"
    return {"three-axes": (all(as_said), "no steady state without any one of the three", lost)}


def models(b, G, r, a, G_a):
    """Section 2: what z(k) is by H, and one step of model A beside one step of three models B.

    b and a are the models, G (2, 1) and G_a (6, 3) are what a push enters through, and r is the measurement's variance.
    """
    position = np.array([[1, 0]])
    push = np.sqrt(b.Q[0, 0])  # of the position, within one step
    at_the_end = (
        f"of s(k+1), the position at the end of step k, save a push of {100 * push:.0f} cm against "
        f"{100 * np.sqrt(r):.0f} cm of noise"
    )
    at_its_start = "of s(k), the position when it begins"
    at = {at_the_end: np.array_equal(b.H, position @ b.F), at_its_start: np.array_equal(b.H, position)}
    seen = "z(k) = s(k) + Δt v(k) + noise, and s(k+1) = s(k) + Δt v(k) + ½ Δt w(k)"
    beyond = f"fed with s(k), the filters are {late(b):.2g} m late at {WALK:g} m/s; fed with H x(k), they are not late"
    rng = np.random.default_rng(1)
    x, w = rng.normal(size=(3, 2)), rng.normal(size=(3, 1))
    moved = gap((a.F @ x.ravel() + G_a @ w.ravel()), (x @ b.F.T + w @ G.T).ravel())
    merged, size = rounding(max(moved, gap(a.H @ x.ravel(), (x @ b.H.T).ravel())))
    return {
        "measured": (at, seen, beyond),
        "merge.models": (merged, f"one step of both, from any state and push: {size}"),
    }


def exists(axis):
    """Section 4: models that fulfil the conditions of the theorem forget P0; of one more it says nothing."""
    tried = forgets_its_start(axis).values()
    fulfil = [forgot for forgot, should in tried if should]
    (of_other,) = [forgot for forgot, should in tried if not should]
    shown = (
        f"a theorem; {sum(fulfil)} of {len(fulfil)} models tried that fulfil it forget P0; it is silent on one more, "
        f"which {'does too' if of_other else 'does not'}"
    )
    return {"exists": (all(fulfil), shown)}


def implementations(a, b, columns, printed):
    """Section 5: estimates and covariances of model B, merged, and how many filters it takes.

    a and b map the names of the filters to x(k/k) and P(k/k) of model A and of the merged model B, columns are the
    estimates of three axes (2, 1) at one step, printed what the paper prints, by id.
    """
    gaps = [rounding(max(gap(a[name][i], b[name][i]) for name in FILTERS)) for i in (0, 1)]
    x, P = [(holds, f"six filters, {len(a['KF'][0])} steps: {size}") for holds, size in gaps]
    written_out = [[each] for column in columns for each in column[:, 0]]  # s_x v_x s_y v_y s_z v_z
    matrix = " × ".join(map(str, np.hstack(columns).T.shape))
    joined = f"one column below the other, as the line above shows; strictly it is a matrix of {matrix}"
    found = {"merge.x": x, "merge.joined": (gap(np.vstack(columns), written_out) == 0, joined), "merge.p": P}
    for id, said, row, one in (("a", 1, 1, burden.kalman(6, 3)), ("b", 2, 7, burden.kalman(2, 1))):
        total, each = int(printed[f"table3.{row}"]), burden.total(one)
        found[f"filters.{id}"] = (total / each == said, f"Table 3 counts {total} = {total / each:g} · {each}")
    return found


def lists(a, b, printed):
    """Table 1: each filter of the two lists in the text runs, and so does the one that a list leaves out."""
    found = {}
    for id, ran in {"filters.list-a": a, "filters.list-b": b}.items():
        (left_out,) = set(FILTERS) - set(printed[id].split()[-1].split("/"))
        runs = all(np.isfinite(ran[name][0]).all() for name in FILTERS)
        found[id] = (runs, f"each of them runs, and so does {left_out}, which Table 1 has too")
    return found


def sums(axes=3):
    """Return how each total of Table 3 is made of those of single filters and joins, in the order of the table.

    >>> sums()[6], sums()[8]
    ('3 · 69', '3 · (69 + 89 + 10)')
    """
    made = []
    for n, m, filters in ((2 * axes, axes, 1), (2, 1, axes)):
        kinds = burden.kalman, burden.lainiotis, burden.join, burden.steady_state, burden.join_steady_state
        kf, lf, join, ss, join_ss = (burden.total(each(n, m)) for each in kinds)
        of_one = kf, lf, f"({kf} + {lf} + {join})", ss, ss, f"({ss} + {ss} + {join_ss})"
        made += [f"{filters} · {each}" for each in of_one]
    return made


def spread(some, a, b):
    """Return the largest difference between some filters, with both models, in x and P."""
    every = [each[name] for name in some for each in (a, b)]
    return max(gap(each, every[0]) for each in every)


def example(a, b, axis):
    """Section 6: what the filters compute; "very close" is closer than σ of the settled filter."""
    near, unknown = closeness(axis), closeness(axis, p0=100)
    k = near["gap"].argmax()
    shown = (
        f"rms gap {near['gap'][k]:.2f} σ at most, at step {k + 1}: {100 * near['metres'][k]:.0f} cm of position, "
        f"{near['metres'][k] / near['kalman'][k]:.1f} times Kalman's own σ there; below σ/10 from step "
        f"{below(near['gap'])} on; {stated(near)}"
    )
    beyond = (
        f"from P0 = 100 I the rms gap is {unknown['metres'][0]:.1f} m at step 1, below σ from step "
        f"{below(unknown['gap'], 1)} on, and below σ/10 from step {below(unknown['gap'])} on"
    )
    return {
        "behaviour.1": rounding(spread(INVARIANT, a, b)),
        "behaviour.2": rounding(spread(STEADY, a, b)),
        "behaviour.3": (bool(near["gap"].max() < 1), shown, beyond),
        "behaviour.4": rounding(max(gap(a[name], b[name]) for name in FILTERS)),
    }


def operations(counts, *some):
    """Return the operations of some filters in words."""
    return "; ".join(f"{name} {counts[f'{name} A']} (A), {counts[f'{name} B']} (B)" for name in some)


def shares(counts):
    """Return the operations of each filter with model B as shares of those with model A, and their range in words."""
    share = [counts[f"{name} B"] / counts[f"{name} A"] for name in FILTERS]
    return share, f"each filter takes {100 * min(share):.0f} to {100 * max(share):.0f} % of model A's operations"


def faster(counts):
    """After Table 3: which filter takes fewer operations."""
    share, shown = shares(counts)
    kf_first = all(counts[f"KF {model}"] < counts[f"LF {model}"] for model in "AB")
    return {"speed.1": (kf_first, operations(counts, "KF", "LF")), "speed.4": (max(share) < 1, f"with model B {shown}")}


def conclusion(counts, of_example):
    """Section 7 and the abstract; of_example is what `example` returned."""
    share, shown = shares(counts)
    (close, apart, elsewhere), (alike, size) = of_example["behaviour.3"], of_example["behaviour.4"]
    at_most, unknown = apart.partition(",")[0], elsewhere.partition(",")[0]
    behaviour = f"models A and B: {size}; steady state: {at_most}; beyond the example, {unknown}"
    last = all(counts[f"JKLF {model}"] > max(counts[f"KF {model}"], counts[f"LF {model}"]) for model in "AB")
    most = {model: max(counts[f"{name} {model}"] for name in STEADY) for model in "AB"}
    least = {model: min(counts[f"{name} {model}"] for name in INVARIANT) for model in "AB"}
    in_steady = "; ".join(f"model {model}: at most {most[model]}, against at least {least[model]}" for model in "AB")
    beyond = f"across models one is slower: JSSKLF A with {most['A']} than KF B with {least['B']}"
    return {
        "abstract.behaviour": (close and alike, behaviour, elsewhere),
        "abstract.burden": (all(each != 1 for each in share), f"with model B {shown}"),
        "speed.2": (last, operations(counts, "JKLF", "KF", "LF")),
        "speed.3": (all(most[model] < least[model] for model in "AB"), in_steady, beyond),
    }
