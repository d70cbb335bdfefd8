"""Measure the package beside its peers in one process: `make bench` writes results.json and fills README.md."""

import json
import os
import platform
import random
import statistics
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import peers
import speedups
import three_axes
from report import write_readme
from tqdm import tqdm

import mpt_helpers as mpt
from mpt_helpers.tracks.files import write_whole

HERE = Path(__file__).parent
AGREE = 1e-8  # the estimates of all libraries, relative to the largest: single steps of some round differently
SHORTEST = 0.02  # seconds a sample lasts at least: what takes less runs several times
ROUNDS = 9
AXIS = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
PLANE = mpt.stack(AXIS, AXIS)
N, M = 1000, 10_000  # steps and tracks without gaps
GAP_N, GAP_M = 200, 5000  # steps and tracks that each miss a tenth of their epochs
FEW = 20  # tracks that the loop over filterpy runs of M; its time is scaled up


def copy(z, n):
    """Read z and write as many planes as there are states, to fresh memory."""
    x = np.empty((len(z), n, z.shape[2]))
    for i in range(n):
        x[:, i] = z[:, i * z.shape[1] // n]
    return x


def seconds(work, times):
    """Return how long one call takes, of so many in a row."""
    start = time.perf_counter()
    for _ in range(times):
        work()
    return (time.perf_counter() - start) / times


def measure(contenders, rounds=ROUNDS, title=""):
    """Return the seconds of each contender in each round; the order in a round is random."""
    times = {}
    for name, work in contenders.items():
        work()
        times[name] = max(1, round(SHORTEST / seconds(work, 1)))
    samples, order = {name: [] for name in contenders}, random.Random(0)
    for _ in tqdm(range(rounds), desc=title, disable=None):
        for name in order.sample(list(contenders), len(contenders)):
            samples[name].append(seconds(contenders[name], times[name]))
    return samples


def row(samples, work, against, goal=None, scale=1.0, tracks=M):
    """Return a row of the table. The ratio is the median over the rounds of one time over the other.

    The goal is ("<=", most), ours over theirs, or (">=", least), theirs over ours: how many times faster we are.
    """
    relation, number = goal or (">=", None)
    pairs = zip(samples[work], samples[against], strict=True)
    value = statistics.median(scale * b / a if relation == ">=" else a / (scale * b) for a, b in pairs)
    met = None if number is None else value >= number if relation == ">=" else value <= number
    return {
        "work": work,
        "tracks": tracks,
        "against": against,
        "ms": 1e3 * statistics.median(samples[work]),
        "against_ms": 1e3 * scale * statistics.median(samples[against]),
        "ratio": value,
        "goal": "" if number is None else f"{relation} {number}" + (" x faster" if relation == ">=" else ""),
        "met": met,
    }


def same(ours, theirs, name):
    """Raise AssertionError unless two arrays are equal, relative to the largest entry."""
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=AGREE * np.abs(theirs).max(), err_msg=name)


def many_tracks():
    """Rows for many tracks without gaps."""
    rng = np.random.default_rng(0)
    z, z2 = rng.standard_normal((N, 1, M)), rng.standard_normal((N, 2, M))
    kf, lf, steady = mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS), mpt.SteadyStateFilter.from_kalman(AXIS)
    few = np.ascontiguousarray(z[..., :FEW])
    missed = z.copy()
    missed[:: N // 10] = np.nan
    works = {
        "copy": partial(copy, z, 2),
        "Kalman": partial(kf.filter, z),
        "Kalman, ten epochs missed by all": partial(kf.filter, missed),
        "Kalman, z transposed": partial(kf.filter, np.ascontiguousarray(z.transpose(2, 0, 1)).transpose(1, 2, 0)),
        "Lainiotis": partial(lf.filter, z),
        "joint": partial(mpt.JoinFilter(kf, lf).filter, z),
        "steady state": partial(steady.filter, z),
        "predictor": partial(mpt.SteadyStatePredictor(steady, 3).filter, z),
        "FIR, 17 taps": partial(mpt.FIRFilter.from_steady_state(steady, tol=1e-3).filter, z),
        "Kalman, model A": partial(mpt.KalmanFilter(PLANE).filter, z2),
        "separate axes": partial(mpt.Separate(kf, kf).filter, z2),
        "simdkalman": lambda: peers.simdkalman_all(AXIS)(z)[0],
        "one filterpy loop per track": partial(peers.filterpy_loop(AXIS), few),
    }
    if peers.DYNAMAX:
        works["dynamax"] = partial(peers.dynamax_vmap(AXIS), peers.jax.numpy.array(z))
    for name in ("simdkalman", "dynamax"):
        if name in works:
            same(works[name](), kf.filter(z), name)
    same(works["one filterpy loop per track"](), kf.filter(few), "filterpy")
    samples = measure(works, title=f"{M} tracks")
    rows = [row(samples, "Kalman", "copy", ("<=", 1.5))]
    for name, goal in {"dynamax": 8, "simdkalman": 150}.items():
        if name in works:
            rows.append(row(samples, "Kalman", name, (">=", goal)))
    rows.append(row(samples, "Kalman", "one filterpy loop per track", (">=", 5000), scale=M / FEW))
    for name in ("Lainiotis", "joint", "steady state", "predictor"):
        rows.append(row(samples, name, "Kalman", ("<=", 2.1 if name == "joint" else 1.1)))
    for name in ("Kalman, ten epochs missed by all", "Kalman, z transposed"):
        rows.append(row(samples, name, "Kalman", ("<=", None)))
    rows.append(row(samples, "separate axes", "Kalman, model A", ("<=", 1.1)))
    rows.append(row(samples, "FIR, 17 taps", "copy", ("<=", 4)))
    return rows


def one_track():
    """Rows for one track of model A, and for one step of it."""
    z = np.random.default_rng(0).standard_normal((N, 2))
    ready = mpt.KalmanFilter(PLANE)
    batch, step = peers.filterpy_batch(PLANE), peers.filterpy_steps(PLANE)
    gaps = np.random.default_rng(1).random(N) < 0.1
    gappy = np.where(gaps[:, None], np.nan, z)
    measured = [None if gap else z_k for gap, z_k in zip(gaps, z, strict=True)]
    works = {
        "Kalman, coefficients ready": partial(ready.filter, z),
        "Kalman, all in, fresh object": lambda: mpt.KalmanFilter(mpt.stack(AXIS, AXIS)).filter(z),
        "filterpy's batch_filter": partial(batch, z),
        "`step`, a thousand times": lambda: by_steps(ready, z),
        "filterpy's predict and update": partial(step, z),
        "Kalman, a tenth missed": partial(ready.filter, gappy),
        "`step`, a tenth missed": lambda: by_steps(ready, gappy),
        "filterpy's predict and update, a tenth missed": partial(step, measured),
    }
    same(ready.filter(z), batch(z), "filterpy")
    same(by_steps(ready, z), step(z), "step")
    same(by_steps(ready, gappy), step(measured), "step")
    same(ready.filter(gappy), step(measured), "filterpy")
    samples = measure(works, title="1 track")
    names = list(works)
    rows = [row(samples, names[i], names[2], (">=", goal), tracks=1) for i, goal in ((0, 30), (1, 6))]
    rows.append(row(samples, names[3], names[4], ("<=", 2.5), tracks=1))
    return [*rows, *(row(samples, names[i], names[7], ("<=", None), tracks=1) for i in (5, 6))]


def by_steps(kf, z):
    """Return the estimates of one track, one step after the other."""
    x, P, estimates = kf.model.x0, kf.P0, []
    for z_k in z:
        x, P = kf.step(x, P, z_k)
        estimates.append(x)
    return np.array(estimates)


def own_gaps():
    """Rows for tracks that each miss epochs of their own, with covariances."""
    rows = []
    for model, name, goal in ((AXIS, "2 states", 8), (PLANE, "4 states", 5)):
        z = with_gaps(model)
        kf, peer = mpt.KalmanFilter(model), peers.simdkalman_all(model)
        x, P = peer(z)
        same(kf.filter(z), x, "simdkalman")
        same(kf.covariances(z), P, "simdkalman")
        works = {
            f"estimates, {name}": partial(kf.estimates, z),
            f"covariances, {name}": partial(kf.covariances, z),
            "simdkalman, both": partial(peer, z),
        }
        if model is AXIS:
            for label, each in (("Lainiotis", mpt.LainiotisFilter(AXIS)), ("steady state", steady_of(AXIS))):
                works[f"covariances, {name}, {label}"] = partial(each.covariances, z)
        samples = measure(works, rounds=5, title=f"own gaps, {name}")
        for work in works:
            if work != "simdkalman, both":
                wanted = (">=", goal) if work == f"estimates, {name}" else None
                rows.append(row(samples, work, "simdkalman, both", wanted, tracks=GAP_M))
    return rows


def moving(model, axes=1):
    """Return the model of an axis, or of several, that starts with a variance of 100."""
    axis = replace(model, P0=100 * np.eye(model.n))
    return mpt.stack(*[axis] * axes)


def long_tracks():
    """Rows for one long track of which a tenth is missed: estimates with covariances, likelihood, smoother and fit."""
    rows = []
    for axes, length in ((1, 12_000), (2, 200), (2, 2_000), (2, 12_000), (2, 100_000)):
        model = moving(mpt.constant_velocity(1.0, 0.05, 0.5), axes)
        rng = np.random.default_rng(0)
        z = mpt.simulate(model, length, rng)[1]
        z[rng.random(length) < 0.1] = np.nan
        kf, loop, peer = mpt.KalmanFilter(model), peers.filterpy_estimates(model), peers.statsmodels_of(model, z)
        both, theirs, smoothed = kf.estimates(z), peer.smooth(), kf.smooth(z)
        same(both.x, loop(z)[0], "filterpy")
        same(both.x, theirs.filtered_state.T, "statsmodels")
        same(both.P, np.moveaxis(theirs.filtered_state_cov, 2, 0), "statsmodels")
        same(smoothed.x, theirs.smoothed_state.T, "statsmodels' smoother")
        same(smoothed.P, np.moveaxis(theirs.smoothed_state_cov, 2, 0), "statsmodels' smoother")
        same(mpt.metrics.log_likelihood(kf, z), np.array(peer.loglike()), "statsmodels' likelihood")
        name = f"one track, {model.n} states, {length:,} rows"
        works = {
            name: partial(kf.estimates, z),
            f"{name}: filterpy loop": partial(loop, z),
            f"{name}: statsmodels' filter": peer.filter,
            f"{name}: log-likelihood": partial(mpt.metrics.log_likelihood, kf, z),
            f"{name}: smoother": partial(kf.smooth, z),
            f"{name}: times": partial(mpt.KalmanFilter(model, t=np.arange(float(length))).estimates, z),
        }
        samples = measure(works, rounds=5, title=name)
        for peer_name, goals in {"filterpy loop": LOOP, "statsmodels' filter": IN_C}.items():
            rows.append(row(samples, name, f"{name}: {peer_name}", goals.get((model.n, length)), tracks=1))
        for work in ("log-likelihood", "smoother", "times"):
            most = 1.2 if work == "log-likelihood" and length == 12_000 else None
            rows.append(row(samples, f"{name}: {work}", name, ("<=", most), tracks=1))
        if length == 12_000:
            works = {
                f"{name}: fit of q and r": partial(mpt.fit, partial(of_axes, axes), z, q=0.2, r=1.0),
                name: partial(kf.estimates, z),
            }
            samples = measure(works, rounds=3, title="fit")
            rows.append(
                row(samples, f"{name}: fit of q and r", name, ("<=", 400), tracks=1)
            )  # 10 s where x, P take 25 ms
    return rows


def pieces():
    """Rows for the code that the lesson on pieces teaches, beside what else somebody might write for one long track."""
    axis = replace(AXIS, H=[[1, 0]], P0=100 * np.eye(2))
    z = mpt.simulate(axis, ROWS, np.random.default_rng(0))[1]
    gappy = np.where(np.random.default_rng(1).random((ROWS, 1)) < 0.05, np.nan, z)
    lesson, kf, track = peers.taught(), mpt.KalmanFilter(axis), f"{ROWS:,} rows as taught"
    works = {
        f"{track}: in pieces": partial(lesson["in_pieces"], gappy[:, 0], 80),
        f"{track}: plain loop of numpy": partial(lesson["one_by_one"], gappy[:, 0]),
        f"{track}: Python numbers": partial(peers.plain_numbers(axis), gappy),
        f"{track}: this package": partial(kf.filter, gappy),
    }
    if peers.COMPILER:
        works[f"{track}: C"] = partial(peers.in_c(axis), gappy)
    expected = kf.filter(gappy)
    for name, work in works.items():
        same(work(), expected, name)
    whole = f"{track}, none missing: lfilter"
    works[whole] = partial(peers.by_lfilter(steady_of(axis)), z)
    same(works[whole]()[100:], kf.filter(z)[100:, 0], whole)  # in 100 rows the start is forgotten to 1e-16
    samples = measure(works, title=track)
    ours, *others = works
    return [row(samples, ours, each, tracks=1) for each in others]


ROWS = 10_000  # of the lesson's recording
# Goals, by states and rows.
LOOP = {(4, 200): (">=", 1), (4, 12_000): (">=", 10), (4, 100_000): (">=", 20)}
IN_C = {(4, 12_000): (">=", 1.3), (4, 100_000): (">=", 2.5)}


def of_axes(axes, q, r):
    """Return the model of `long_tracks` with these parameters."""
    return moving(mpt.constant_velocity(1.0, q, r), axes)


def times_and_smoother():
    """Rows for many tracks with gaps of their own: times of their own too, and the smoother."""
    rows = []
    for axes in (1, 2):
        model = moving(mpt.constant_velocity(1.0, 0.05, 0.5), axes)
        z = with_gaps(model)
        t = np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, (GAP_N, GAP_M)), axis=0)
        kf, timed, few = mpt.KalmanFilter(model), mpt.KalmanFilter(model, t=t), np.ascontiguousarray(z[..., :1000])
        for ours, theirs in zip(kf.smooth(few), peers.simdkalman_smoother(model)(few), strict=True):
            same(ours, theirs, "simdkalman's smoother")
        own, name = f"estimates, gaps of their own, {model.n} states", f"times of their own, {model.n} states"
        samples = measure({own: partial(kf.estimates, z), name: partial(timed.estimates, z)}, title=name)
        rows.append(row(samples, name, own, ("<=", 2 if axes == 1 else None), tracks=GAP_M))
        both, name = f"filter, then covariances, {model.n} states", f"smoother, {model.n} states"
        works = {
            both: partial(estimates_and_covariances, kf, few),
            name: partial(kf.smooth, few),
            f"{name}: simdkalman": partial(peers.simdkalman_smoother(model), few),
        }
        samples = measure(works, rounds=5, title=name)
        rows.append(row(samples, name, both, ("<=", 3), tracks=1000))
        rows.append(row(samples, name, f"{name}: simdkalman", tracks=1000))
    return rows


def layouts():
    """Rows for tracks of different lengths and for z in another order of memory, beside the same numbers in order."""
    kf, z = mpt.KalmanFilter(AXIS), with_gaps(AXIS)
    ragged = np.random.default_rng(1).standard_normal(z.shape)
    ends = np.random.default_rng(2).integers(GAP_N // 2, GAP_N, GAP_M)
    ragged[np.arange(GAP_N)[:, None, None] >= ends] = np.nan
    wide = np.zeros((GAP_N, 1, 2 * GAP_M))
    wide[..., ::2] = z
    works = {
        "tracks of different lengths": ragged,
        "z transposed": np.ascontiguousarray(z.transpose(2, 0, 1)).transpose(1, 2, 0),
        "z strided": wide[..., ::2],
        "gaps of their own, in order": z,
    }
    samples = measure(
        {name: partial(estimates_and_covariances, kf, each) for name, each in works.items()}, title="layout"
    )
    return [row(samples, name, "gaps of their own, in order", ("<=", 1.3), tracks=GAP_M) for name in list(works)[:3]]


def steady_of(model):
    """Return the steady-state filter of a model."""
    return mpt.SteadyStateFilter.from_kalman(model)


def with_gaps(model):
    """Return measurements of many tracks that each miss a tenth of their epochs."""
    rng = np.random.default_rng(0)
    z = rng.standard_normal((GAP_N, model.m, GAP_M))
    z[np.broadcast_to(rng.random((GAP_N, 1, GAP_M)) < 0.1, z.shape)] = np.nan
    return z


def estimates_and_covariances(each, z):
    """Return both, by two calls."""
    return each.filter(z), each.covariances(z)


def squares(kf, steps, rng, runs):
    """Return the mean squared error of each state of a filter: an experiment for `study`."""
    x, z = mpt.simulate(kf.model, steps, rng, tracks=runs)
    e = kf.filter(z)
    e -= x
    return np.einsum("kim,kim->im", e, e) / steps


def numbers_only(model, steps, rng, runs):
    """Draw what `simulate` draws, and no more."""
    for rows in (1, steps):
        rng.standard_normal((rows, model.n, runs))
    return rng.standard_normal((steps, model.m, runs))[0]


def least(model, steps, rng, runs):
    """Draw what `simulate` draws, and move what a study cannot do without: states, measurements, estimates, errors."""
    rng.standard_normal((1, model.n, runs))
    x = rng.standard_normal((steps, model.n, runs))
    z = rng.standard_normal((steps, model.m, runs))
    x *= 1.0
    z *= 1.0
    e = x.copy()
    e -= x
    return np.einsum("kim,kim->im", e, e)


def study():
    """Rows for a Monte Carlo study, by one and by two workers."""
    name, against, limit = "study of 10,000 runs", "its random numbers", "its random numbers, each array written once"
    kf, rows = mpt.KalmanFilter(AXIS), []
    for workers in (1, 2):
        works = {
            name: partial(mpt.study, partial(squares, kf, N), M, 1, workers=workers),
            against: partial(mpt.study, partial(numbers_only, AXIS, N), M, 1, workers=workers),
            limit: partial(mpt.study, partial(least, AXIS, N), M, 1, workers=workers),
        }
        samples = measure(works, title=f"study, {workers} workers")
        title = {"work": f"{name}, workers={workers}"}
        rows.append(row(samples, name, against, ("<=", 1.25)) | title)
        rows.append(row(samples, name, limit, ("<=", None)) | title)
    return rows


def commands():
    """Return what `make clock` prints of the everyday commands, in the environment that runs them."""
    python = HERE.parent / ".venv" / "bin" / "python"
    run = subprocess.run([python, HERE.parent / "tests" / "tools" / "clock.py"], capture_output=True, text=True)
    return run.stdout.strip() if run.returncode == 0 else "not measured: one of the commands failed"


def wall_clock():
    """Return the papers' speedups on the clock: one track, many with covariances of their own, many that share them."""
    kinds = {"one": (speedups.steps, 1), "own": (speedups.steps, M), "shared": (speedups.shared_steps, M)}
    result = {}
    for kind, (make, tracks) in kinds.items():
        works = {
            f"{name} {axes}": step
            for axes in (1, 2, 3)
            for name, step in make(mpt.stack(*[AXIS] * axes), tracks).items()
        }
        samples = measure(works, title=f"steps, {kind}")
        for axes, paper in ((2, "2014_gsm_2d"), (3, "2015_mpt_3d")):
            pairs = {
                "kf-lf-a": (f"KF {axes}", f"LF {axes}", 1),
                "kf-lf-b": ("KF 1", "LF 1", 1),
                "kf-a-sskf-b": ("SS 1", f"KF {axes}", 1 / axes),  # model B runs a filter for each axis
                "lf-a-sslf-b": ("SS 1", f"LF {axes}", 1 / axes),
            }
            for pair, (fast, slow, scale) in pairs.items():  # the first is named as the faster one
                value = row(samples, fast, slow, scale=scale)["ratio"]
                result.setdefault(paper, {}).setdefault(pair, {})[kind] = value
    return result


def machine():
    """Return what the numbers were measured on, and how busy it was."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    models = {line.split(":")[1].strip() for line in lines if line.startswith("model name")} or {platform.processor()}
    return {"processor": ", ".join(models), "cores": os.cpu_count(), "system": platform.system()}


def versions():
    """Return the versions of Python and of everything in environment.txt."""
    pinned = [line.split("==")[0] for line in (HERE / "environment.txt").read_text().splitlines() if "==" in line]
    return {"python": platform.python_version()} | {name: version(name) for name in pinned}


def main():
    """Measure everything, then write both files."""
    load = os.getloadavg()[0]
    speedups.agree(AGREE)
    three_axes.agree(AGREE)
    rows = [
        *many_tracks(),
        *one_track(),
        *long_tracks(),
        *pieces(),
        *own_gaps(),
        *times_and_smoother(),
        *layouts(),
        *study(),
    ]
    results = {
        "machine": machine() | {"programs that ran at the start": f"{load:.1f}"},
        "versions": versions(),
        "rows": rows,
        "speedups": wall_clock(),
        "three axes": three_axes.on_the_clock(measure),
        "commands": commands(),
    }
    write_whole(HERE / "results.json", (json.dumps(results, indent=1) + "\n").encode())
    write_readme()


if __name__ == "__main__":
    sys.exit(main())
