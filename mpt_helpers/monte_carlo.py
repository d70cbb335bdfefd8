"""Monte Carlo studies: many runs from one seed, with results that do not depend on the number of workers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from . import _checks as checks

# Number of runs that share a stream of random numbers. With another number, a seed gives other results.
BLOCK = 200
RESULT = f"a result of M = {BLOCK} columns, (..., M)"


def study(
    experiment: Callable[[np.random.Generator, int], ArrayLike],
    runs: int,
    seed: int,
    *,
    workers: int | Callable[..., Iterable[Any]] = 1,
) -> np.ndarray:
    """Return the results of many runs of an experiment.

    Each block of 200 runs draws from its own stream, made from the seed. So the results do not depend on the number of
    workers, and a longer study begins with the runs of a shorter one.

    Parameters
    ----------
    experiment : callable
        experiment(rng, M) draws from a numpy Generator and returns an array (..., M), one column for each of M = 200
        runs.
    runs : int
        Number of runs; the last block is cut to it.
    seed : int
        Seed of the random numbers, not negative.
    workers : int or callable
        Number of threads, or a callable like `map` that keeps the order: the `map` of a `concurrent.futures` executor,
        for example, or one that uses a dask cluster. For processes, the experiment must be picklable.

    Returns
    -------
    ndarray (..., runs)
        The results of the runs.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> means = mpt.study(lambda rng, M: rng.standard_normal((100, M)).mean(axis=0), runs=1000, seed=1)
    >>> means.shape, means.std().round(2)
    ((1000,), np.float64(0.1))

    """
    if not callable(experiment):
        checks.refuse("experiment", "a callable of (rng, M)", type(experiment).__name__, TypeError)
    runs, seed = checks.count("runs", runs), checks.count("seed", seed, least=0)
    blocks = -(-runs // BLOCK)
    results, done = np.empty(0), 0
    with _mapper(workers) as mapper, tqdm(total=runs, unit="run", disable=None, leave=False) as bar:
        for part in mapper(partial(_run_block, experiment, seed), range(blocks)):
            if not done:  # all memory is taken at once, so that a lack of it shows at the start
                results = np.empty((*part.shape[:-1], blocks * BLOCK), part.dtype)
            elif (part.dtype, part.shape[:-1]) != (results.dtype, results.shape[:-1]):
                both = " and ".join(f"{(*each.shape[:-1], BLOCK)} of {each.dtype}" for each in (results, part))
                checks.refuse("experiment", "results of one shape and type", both)
            results[..., done * BLOCK : (done + 1) * BLOCK] = part
            done += 1
            bar.update(min(BLOCK, runs - bar.n))
    if done != blocks:
        checks.refuse("workers", "a callable like map", f"one that gives {done} of {blocks} results")
    return results[..., :runs]


def _run_block(experiment, seed, number):
    # After an array of 32 MB was freed, glibc keeps freed arrays of up to that size for the next block. Otherwise the
    # system maps and zeroes them anew for each block.
    np.empty(2**25 - 2**16, np.uint8)
    stream = np.random.SeedSequence(seed, spawn_key=(number,))  # as `spawn` makes it
    part = experiment(np.random.Generator(np.random.SFC64(stream)), BLOCK)
    if np.asarray(part).dtype != bool:
        part = checks.real_numbers("experiment", part, RESULT)
    part = np.asarray(part)
    if part.ndim == 0 or part.shape[-1] != BLOCK:
        checks.refuse("experiment", RESULT, f"shape {part.shape}")
    return part.copy()  # an experiment may return the same buffer again


@contextmanager
def _mapper(workers):
    """Yield a callable like `map`. On exit, also after an error, blocks that have not started are cancelled."""
    if callable(workers):
        yield workers
    elif checks.count("workers", workers) == 1:
        yield map
    else:
        executor = ThreadPoolExecutor(workers)
        try:
            yield executor.map
        finally:
            executor.shutdown(cancel_futures=True)  # `map` itself does not cancel them when it is interrupted
