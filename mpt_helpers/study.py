"""Monte Carlo studies: many runs from one seed, the same numbers whatever the tile size and the number of workers."""

import threading
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial

import numpy as np
from tqdm import tqdm

from . import checks

# So many runs share a stream of random numbers and are filtered together: it is part of what a seed means.
BLOCK = 200
NEED = f"a result of M = {BLOCK} columns, (..., M)"
KEPT = 2**25 - 2**16  # below the most that glibc keeps; else it returns each run's arrays to the kernel and asks anew


def study(experiment, runs, seed, *, tile=BLOCK, workers=1):
    """Return the statistics of many runs of an experiment, (..., runs).

    experiment(rng, M) draws from a numpy Generator and returns an array (..., M), one column for each of M runs. It is
    called for blocks of 200 runs, each with its own stream of the seed, so that no result depends on tile or workers,
    and the first runs of a longer study are those of a shorter one. Only the statistics are kept.

    runs and tile (the runs of one task) are positive counts, seed is an integer that is not negative. workers is a
    number of threads, or a map-like callable, such as the `map` of a `concurrent.futures` executor; then the experiment
    must be what that callable can send to its workers. A progress bar runs on a terminal, and nowhere else. An
    interrupt ends the study with the blocks at work.

    Raises ValueError or TypeError for bad arguments and for an experiment that does not return M columns.

    >>> study(lambda rng, M: rng.standard_normal((100, M)).mean(axis=0), runs=1000, seed=1).std().round(2)
    np.float64(0.1)
    """
    checks.function("experiment", experiment, "a callable of (rng, M)")
    runs, tile, seed = checks.count("runs", runs), checks.count("tile", tile), checks.count("seed", seed, least=0)
    streams = np.random.SeedSequence(seed).spawn(-(-runs // BLOCK))
    blocks = -(-tile // BLOCK)
    tasks = [streams[i : i + blocks] for i in range(0, len(streams), blocks)]
    with _mapper(workers) as (mapper, stop), tqdm(total=runs, unit="run", disable=None, leave=False) as bar:
        parts = []
        results = mapper(partial(_tile, experiment, stop), tasks)
        for part in results if isinstance(results, Iterable) else [results]:
            if not isinstance(part, np.ndarray):
                checks.refuse("workers", "a callable like map", f"one that gives {checks.brief(part)}", TypeError)
            parts.append(part)
            bar.update(part.shape[-1])
    if len(parts) != len(tasks):
        checks.refuse("workers", "a callable like map", f"one that gives {len(parts)} results of {len(tasks)} tasks")
    return _side_by_side(parts)[..., :runs]


def _tile(experiment, stop, streams):
    np.empty(KEPT, np.uint8)  # freed at once: from then on the C library reuses memory of up to this size
    parts = []
    for stream in streams:
        if stop is not None and stop.is_set():
            break
        part = experiment(np.random.Generator(np.random.SFC64(stream)), BLOCK)
        if getattr(part, "dtype", None) != np.dtype(bool):
            part = checks.numbers("experiment", part, NEED)
        if not part.ndim or part.shape[-1] != BLOCK:
            checks.refuse("experiment", NEED, f"shape {part.shape}")
        parts.append(np.array(part))  # a copy: an experiment may return the same buffer again
    return _side_by_side(parts) if parts else None


def _side_by_side(parts):
    if len(shapes := {part.shape[:-1] for part in parts}) > 1:
        checks.refuse("experiment", "results of one shape", " and ".join(f"{(*shape, BLOCK)}" for shape in shapes))
    return np.concatenate(parts, axis=-1)


@contextmanager
def _mapper(workers):
    """Give a map-like callable and, for threads of our own, the event that stops them."""
    if callable(workers):
        yield workers, None
        return
    threads = checks.count("workers", workers)
    if threads == 1:
        yield map, None
        return
    executor, stop = ThreadPoolExecutor(threads), threading.Event()
    try:
        yield executor.map, stop
    finally:
        stop.set()
        executor.shutdown(wait=False, cancel_futures=True)
