"""Measure the package beside its peers in one process: `make bench` writes results.json and fills README.md."""

import json
import os
import platform
import random
import shutil
import statistics
import subprocess
import sys
import time
import tracemalloc
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import peers
import speedups
from line_profiler import LineProfiler
from report import write_readme
from tqdm import tqdm

import mpt_helpers as mpt
from mpt_helpers import recursion
from mpt_helpers.files import write_whole

HERE = Path(__file__).parent
AGREE = 1e-8  # the estimates of all libraries, relative to the largest: single steps of some round differently
SHORTEST = 0.02  # seconds a sample lasts at least: what takes less runs several times
ROUNDS = 9
AXIS = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
PLANE = mpt.stack(AXIS, AXIS)
N, M = 1000, 10_000
FEW = {"one filterpy loop per track": 20, "pykalman": 2, "statsmodels": 20}  # tracks run of M; the time is scaled up


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


def ratio(samples, above, below, scale=1.0):
    """Return the median over the rounds of one time over another."""
    return scale * statistics.median(a / b for a, b in zip(samples[above], samples[below], strict=True))


def row(samples, work, against, goal, faster=False, scale=1.0):
    """Return a row of the table: the ratio is ours over theirs, or theirs over ours where `faster` is the goal."""
    value = ratio(samples, against, work, scale) if faster else ratio(samples, work, against)
    return {
        "work": work,
        "against": against,
        "ms": 1e3 * statistics.median(samples[work]),
        "against_ms": 1e3 * scale * statistics.median(samples[against]),
        "ratio": value,
        "goal": f">= {goal} x faster" if faster else f"<= {goal}",
        "met": value >= goal if faster else value <= goal,
    }


def require_agreement(z):
    """Raise AssertionError unless all libraries give the same estimates."""
    few, coefficients = np.ascontiguousarray(z[..., :3]), mpt.KalmanFilter(AXIS).coefficients(N)
    expected = mpt.KalmanFilter(AXIS).filter(few)
    plane = np.concatenate([z[..., 0], z[..., 1]], axis=1)
    others = {
        "filterpy": peers.filterpy_loop(AXIS)(few),
        "pykalman": peers.pykalman_loop(AXIS)(few),
        "simdkalman": peers.simdkalman_all(AXIS)(few),
        "statsmodels": peers.statsmodels_loop(AXIS)(few),
        "dynamax": peers.dynamax_vmap(AXIS)(few),
        "numba": peers.numba_loop(AXIS, coefficients)(few),
    }
    for name, x in others.items():
        np.testing.assert_allclose(x, expected, rtol=0, atol=AGREE * np.abs(expected).max(), err_msg=name)
    both = mpt.KalmanFilter(PLANE).filter(plane), peers.filterpy_batch(PLANE)(plane)
    np.testing.assert_allclose(*both, rtol=0, atol=AGREE * np.abs(both[0]).max())
    speedups.agree(AGREE)


def many_tracks(z, z2):
    """Rows for many tracks."""
    kf, lf, steady = mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS), mpt.SteadyStateFilter.from_kalman(AXIS)
    fir, plane = mpt.FIRFilter.from_steady_state(steady, tol=1e-3), mpt.KalmanFilter(PLANE)
    few, on_device = (
        {name: np.ascontiguousarray(z[..., :count]) for name, count in FEW.items()},
        peers.jax.numpy.array(z),
    )
    samples = measure(
        {
            "copy": partial(copy, z, 2),
            "Kalman": partial(kf.filter, z),
            "Lainiotis": partial(lf.filter, z),
            "joint": partial(mpt.JoinFilter(kf, lf).filter, z),
            "steady state": partial(steady.filter, z),
            "predictor": partial(mpt.SteadyStatePredictor(steady, 3).filter, z),
            "FIR, 17 taps": partial(fir.filter, z),
            "Kalman, model A": partial(plane.filter, z2),
            "separate axes": partial(mpt.Separate(kf, kf).filter, z2),
            "dynamax": partial(peers.dynamax_vmap(AXIS), on_device),
            "numba": partial(peers.numba_loop(AXIS, kf.coefficients(N)), z),
            "simdkalman": partial(peers.simdkalman_all(AXIS), z),
            "one filterpy loop per track": partial(peers.filterpy_loop(AXIS), few["one filterpy loop per track"]),
            "pykalman": partial(peers.pykalman_loop(AXIS), few["pykalman"]),
            "statsmodels": partial(peers.statsmodels_loop(AXIS), few["statsmodels"]),
        },
        title=f"{M} tracks",
    )
    scale = {name: M / count for name, count in FEW.items()}
    rows = [row(samples, "Kalman", "copy", 1.5)]
    for name, goal in {"dynamax": 8, "simdkalman": 150, "one filterpy loop per track": 5000}.items():
        rows.append(row(samples, "Kalman", name, goal, faster=True, scale=scale.get(name, 1.0)))
    for name in ("numba", "statsmodels", "pykalman"):
        rows.append(
            row(samples, "Kalman", name, 0, faster=True, scale=scale.get(name, 1.0)) | {"goal": "", "met": None}
        )
    for name in ("Lainiotis", "joint", "steady state", "predictor"):
        rows.append(row(samples, name, "Kalman", 2.1 if name == "joint" else 1.1))
    rows.append(row(samples, "separate axes", "Kalman, model A", 1.1))
    rows.append(row(samples, "FIR, 17 taps", "copy", 4))
    return [each | {"tracks": M} for each in rows]


def fewer_tracks(z):
    """Rows for a thousand tracks and for one."""
    kf, one = mpt.KalmanFilter(AXIS), z[:, 0, :2].copy()
    samples = measure({"copy": partial(copy, z, 2), "Kalman": partial(kf.filter, z)}, title="1000 tracks")
    rows = [row(samples, "Kalman", "copy", 3) | {"tracks": z.shape[2]}]
    names = "Kalman, model A, coefficients ready", "Kalman, model A, all in, fresh object", "filterpy batch_filter"
    ready, batch = mpt.KalmanFilter(PLANE), peers.filterpy_batch(PLANE)
    works = partial(ready.filter, one), lambda: mpt.KalmanFilter(mpt.stack(AXIS, AXIS)).filter(one), partial(batch, one)
    samples = measure(dict(zip(names, works, strict=True)), title="1 track")
    for name, goal in zip(names, (100, 8), strict=False):
        rows.append(row(samples, name, names[-1], goal, faster=True) | {"tracks": 1})
    return rows


def missed_epochs(z):
    """Rows for missed epochs: the same for all tracks, and two patterns in a random order of tracks."""
    kf, some = mpt.KalmanFilter(AXIS), np.random.default_rng(0).random(M) < 0.5
    gaps = {
        "ten missed epochs, shared": (slice(50, None, 100), 1.1),
        "two patterns of missed epochs, unlike from the middle on": ((500, slice(None), some), 2),
        "two patterns of missed epochs, unlike from the start on": ((0, slice(None), some), 2),
    }
    data = {"Kalman": z} | {name: z.copy() for name in gaps}
    for name, (gap, _) in gaps.items():
        data[name][gap] = np.nan
    samples = measure({name: partial(kf.filter, each) for name, each in data.items()}, title="missed epochs")
    return [row(samples, name, "Kalman", goal) | {"tracks": M} for name, (_, goal) in gaps.items()]


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


def study():
    """Rows for a Monte Carlo study, by one and by two workers."""
    name, against = "study of 10,000 runs", "its random numbers"
    kf, rows = mpt.KalmanFilter(AXIS), []
    for workers in (1, 2):
        samples = measure(
            {
                name: partial(mpt.study, partial(squares, kf, N), M, 1, workers=workers),
                against: partial(mpt.study, partial(numbers_only, AXIS, N), M, 1, workers=workers),
            },
            title=f"study, {workers} workers",
        )
        rows.append(row(samples, name, against, 1.25) | {"tracks": M, "work": f"{name}, workers={workers}"})
    return rows


def peak(work):
    """Return the most memory that is held during a call, in bytes, with what it returns."""
    tracemalloc.start()
    result = work()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most, result


def memory(z):
    """Rows for memory: beyond the estimates, and of a study as it grows."""
    most, x = peak(partial(mpt.KalmanFilter(AXIS).filter, z))
    extra = most / x.nbytes - 1
    trial = partial(squares, mpt.KalmanFilter(AXIS), N)
    few, many = (peak(partial(mpt.study, trial, runs, 1))[0] for runs in (M, 5 * M))
    both = (
        ("extra memory at the peak", "the estimates", extra, 0.05),
        ("memory of a study of 50,000 runs", "one of 10,000", many / few, 1.05),
    )
    keys = "work", "against", "ratio", "goal"
    return [dict(zip(keys, each, strict=True)) | {"goal": f"<= {each[3]}", "met": each[2] <= each[3]} for each in both]


def growth():
    """Return the nanoseconds per track and step as tracks and steps grow, and the largest rise from one to the next."""
    rng, kf = np.random.default_rng(0), mpt.KalmanFilter(AXIS)
    sizes = {"tracks": [(N, tracks) for tracks in (100, 1000, 10_000, 100_000)]}
    for tracks in (1, 100, 1000):
        sizes[f"steps of {tracks}"] = [(steps, tracks) for steps in (100, 1000, 10_000, 100_000)]
    result = []
    for kind, pairs in sizes.items():
        data = {pair: rng.standard_normal((pair[0], 1, pair[1])) for pair in pairs}
        samples = measure({pair: partial(kf.filter, z) for pair, z in data.items()}, rounds=5, title=f"more {kind}")
        each = {pair: 1e9 * statistics.median(taken) / pair[0] / pair[1] for pair, taken in samples.items()}
        copies = measure({pair: partial(copy, z, 2) for pair, z in data.items()}, rounds=5, title="copies")
        floor = {pair: 1e9 * statistics.median(taken) / pair[0] / pair[1] for pair, taken in copies.items()}
        for before, pair in zip([None, *pairs], pairs, strict=False):
            rise = each[pair] / each[before] if before else None
            keys = {"kind": kind, "steps": pair[0], "tracks": pair[1], "ns": each[pair], "copy_ns": floor[pair]}
            result.append(keys | {"rise": rise, "met": rise is None or rise <= 1.2})
    return result


def reproduce():
    """Return the row for `make reproduce` after set-up, in a copy of the project."""
    python = HERE.parent / ".venv" / "bin" / "python"
    with TemporaryDirectory() as place:
        for name in ("notebooks", "figures", "benchmarks"):
            shutil.copytree(HERE.parent / name, Path(place) / name)
        start = time.perf_counter()
        subprocess.run([python, "-m", "mpt_helpers", "reproduce"], cwd=place, check=True, stdout=subprocess.DEVNULL)
        taken = time.perf_counter() - start
    return {"work": "make reproduce", "against": "one second", "ratio": taken, "goal": "<= 90", "met": taken <= 90}


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
                "kf-lf-a": ratio(samples, f"LF {axes}", f"KF {axes}"),
                "kf-lf-b": ratio(samples, "LF 1", "KF 1"),
                "kf-a-sskf-b": ratio(samples, f"KF {axes}", "SS 1", 1 / axes),  # model B runs a filter for each axis
                "lf-a-sslf-b": ratio(samples, f"LF {axes}", "SS 1", 1 / axes),
            }
            for pair, value in pairs.items():
                result.setdefault(paper, {}).setdefault(pair, {})[kind] = value
    return result


def profile(z):
    """Return the share of the time that each line of the inner loop takes, of many tracks and of one."""
    result = {}
    for tracks in (M, 1):
        kf, part = mpt.KalmanFilter(AXIS), np.ascontiguousarray(z[..., :tracks])
        kf.filter(part)
        profiler = LineProfiler(recursion._fill)
        for _ in range(max(1, 200 // tracks)):
            profiler.runcall(kf.filter, part)
        (lines,) = profiler.get_stats().timings.values()
        source = Path(recursion.__file__).read_text().splitlines()
        total = sum(taken for _, _, taken in lines)
        for number, _, taken in lines:
            result.setdefault(source[number - 1].strip(), {})[str(tracks)] = taken / total
    return {line: shares for line, shares in result.items() if max(shares.values()) > 0.02}


def machine():
    """Return what the numbers were measured on."""
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
    rng = np.random.default_rng(0)
    z, z2 = rng.standard_normal((N, 1, M)), rng.standard_normal((N, 2, M))
    require_agreement(z)
    rows = [
        *many_tracks(z, z2),
        *fewer_tracks(rng.standard_normal((N, 1, 1000))),
        *missed_epochs(z),
        *study(),
        *memory(z),
    ]
    results = {
        "machine": machine(),
        "versions": versions(),
        "rows": [*rows, reproduce()],
        "growth": growth(),
        "speedups": wall_clock(),
        "profile": profile(z),
    }
    write_whole(HERE / "results.json", (json.dumps(results, indent=1) + "\n").encode())
    write_readme()


if __name__ == "__main__":
    sys.exit(main())
