"""Maximum-likelihood parameters of a model, with their standard errors and with warnings of a doubtful fit.

A *point* is the vector of the natural logarithms of the parameters; `search` finds the point of the largest log L.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit
from tqdm import tqdm

from . import _checks as checks
from . import metrics
from ._base import Filter
from ._checks import Array
from ._immutable import same, types_as_written
from .kalman import KalmanFilter
from .model import LinearModel
from .search import FLAT_CURVATURE, SIGNIFICANT, coordinate_descent, finite_differences, line_search, newton

# Rows for each state that the search along a ratio skips: after them the initial state hardly matters.
START_ROWS_PER_STATE = 5
# Smallest factor of Q and R: constant measurements would make all variances zero.
MIN_SCALE = 1e-9
# Number of blocks for the standard errors, and their length on long tracks. On recorded tracks, the scores of blocks
# of 10 s are strongly correlated; those of 300 s are nearly independent.
MIN_BLOCKS, MAX_BLOCKS, BLOCK_SECONDS = 6, 20, 300.0
# A parameter is determined if its component along each flat direction of log L is below this. Smaller components come
# from the tolerance of the search.
MAX_FLAT_COMPONENT = 1e-2
# A parameter that differs from its guess by this factor may be in the wrong units: kilometres instead of metres change
# q and r by 1e-6, milliseconds instead of seconds change q by 1e-9, degrees change both by 1e-10.
SUSPICIOUS_RATIO = 1e5
# A parameter whose logarithm has a larger standard error is undetermined.
UNKNOWN = math.log(10)
# Distance of x0 from the initial state that the measurements suggest, in standard deviations. Beyond the first a fit is
# refused. Beyond the second it warns, since a wrong q and r make up for the distance.
MAX_START_DISTANCE, DOUBTFUL_START_DISTANCE = 1e3, 10.0


@types_as_written
class Fit(NamedTuple):
    """The result of `fit`; printed, it is a table of values and errors.

    Attributes
    ----------
    values, log_errors : dict
        The parameters by name, and the standard errors of their natural logarithms: 0.1 stands for ten percent.
    filter : Filter
        The filter with these values.
    log_likelihood : float
        log L.
    errors_from : str
        What the errors were computed from: "15 blocks of 300 fixes", "40 tracks" or "curvature", for example.

    """

    values: dict[str, float]
    log_errors: dict[str, float]
    filter: Filter
    log_likelihood: float
    errors_from: str

    def _rows(self):
        """Return the cells of the table, its heading first."""
        rows = [("", "value", "log error", "95 % interval")]
        for name, value in self.values.items():
            error = self.log_errors[name]
            low, high = value * np.exp([-1.96 * error, 1.96 * error]) if error < 300 else (0.0, math.inf)
            rows.append((name, f"{value:.4g}", f"{error:.2g}", f"{low:.3g} to {high:.3g}"))
        return rows

    def _foot(self):
        return f"log L = {self.log_likelihood:.6g}; errors from {self.errors_from}"

    def __repr__(self) -> str:
        rows = self._rows()
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
        return "\n".join([*lines, self._foot()])

    def _repr_html_(self) -> str:
        """Return the table as a notebook shows it."""

        def line(cells, tag):
            return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

        heading, *rows = self._rows()
        body = "".join(line(row, "td") for row in rows)
        return f"<table>{line(heading, 'th')}{body}</table><p>{escape(self._foot())}</p>"


def fit(make: Callable[..., LinearModel | Filter], z: ArrayLike, **start: float) -> Fit:
    """Estimate positive parameters by maximum likelihood, jointly over all tracks.

    The standard errors `log_errors` are robust: they also hold for a wrong model (White 1982). For recorded tracks the
    model is always wrong, since their q varies, and the curvature of log L alone gives errors five to twenty times too
    small. Each track is cut into blocks of about 300 s, 6 to 20 in all, and the errors follow from the scatter of the
    blocks' scores. With fewer than 12 fixes the errors are those of the curvature.

    Parameters
    ----------
    make : callable
        ``make(**values)`` returns a filter, or the model of a Kalman filter. Rows that are not evenly spaced need a
        filter with times `t`: without them q may come out a hundred times too large, without a warning.
    z : array_like, (N, m) or (N, m, M)
        Measurements, NaN where missing.
    **start : float
        A first guess of each parameter by its name.

    Returns
    -------
    Fit
        The parameters, their errors and the filter.

    Raises
    ------
    ValueError
        If there are no more measurements than parameters, if x0 of a Kalman filter is more than a thousand standard
        deviations from the first measurements of a track, or if log L is not finite at the guess.

    Warns
    -----
    UserWarning
        If z does not determine a parameter, if a parameter differs from its guess by a factor of 1e5, if the first
        measurements are far from x0, and if `metrics.suspicious` finds an outlier or two rows of the same time.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> make = lambda q, r: mpt.constant_velocity(dt=1.0, q=q, r=r, P0=np.eye(2))
    >>> _, z = mpt.simulate(make(q=0.04, r=0.5), N=500, rng=1)
    >>> mpt.fit(make, z, q=1.0, r=1.0)
         value  log error    95 % interval
    q  0.03496       0.39  0.0163 to 0.075
    r   0.5659       0.11   0.455 to 0.704
    log L = -744.073; errors from 6 blocks of 83 fixes

    """
    if not callable(make):
        checks.refuse("make", "a function that returns a model or a filter", type(make).__name__, TypeError)
    if not start:
        checks.refuse("start", "a first guess of at least one parameter", "none")
    guess = {name: checks.positive(name, value) for name, value in start.items()}
    estimator = _filter_of(make, guess)
    z = checks.measurements(z, estimator.model.m)
    if (count := int(np.isfinite(z).sum())) <= len(guess):
        checks.refuse("z", f"more measurements than parameters, of which there are {len(guess)}", count)
    if (distance := _distance_of_x0(estimator, z)) > MAX_START_DISTANCE:
        need = "a model whose x0 and P0 say where the tracks begin (x0 at the first measurement, or z - z[0])"
        checks.refuse("make", need, f"first measurements {distance:.0f} standard deviations away")
    with tqdm(desc="fit", unit=" filters", disable=None, leave=False) as bar:
        likelihood = NegativeLogLikelihood(make, list(guess), z, bar=bar)
        origin = np.log(list(guess.values()))
        if not math.isfinite(likelihood(origin)):
            metrics.log_likelihood(estimator, z)  # raises, and says why
            checks.refuse("start", "parameters at which log L is finite", guess)
        near = _search_along_ratio(likelihood, origin, estimator.model.n)
        best = coordinate_descent(likelihood, origin) if near is None else newton(likelihood, near)
        # If log L does not fall as a parameter goes towards zero, or cannot be computed, z gives only an upper limit.
        further = np.array([_towards_zero(likelihood, best, unit) for unit in np.eye(len(best))])
        bounded = (further >= likelihood(best) + SIGNIFICANT) & np.isfinite(further)
        blocks = blocks_of(estimator, z)
        errors = log_errors(likelihood, best, np.flatnonzero(bounded), blocks)
    log_errors_by_name = dict(zip(guess, errors.tolist(), strict=True))
    values, found = likelihood.values_at(best), likelihood.filter_at(best)
    result = Fit(values, log_errors_by_name, found, -likelihood(best), blocks.name)
    for text in _warnings(result, z, guess, bounded, further):
        checks.warn(f"fit: {text}")
    return result


@dataclass(frozen=True)
class NegativeLogLikelihood:
    """-log L of measurements z as a function of a point, the natural logarithms of the parameters of `make`.

    counts (N,) marks the rows that enter the sum; all do where it is None. Values are cached, since a search returns to
    the same points.
    """

    make: Callable[..., LinearModel | Filter]
    names: list[str]
    z: Array
    counts: Array | None = None
    bar: tqdm | None = None
    computed: dict[bytes, float] = field(default_factory=dict)

    def values_at(self, point: Array) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.names, np.exp(point).tolist(), strict=True))

    def filter_at(self, point: Array) -> Filter:
        """Return the filter with these parameters."""
        return _filter_of(self.make, self.values_at(point))

    def _terms(self, point):
        """Return NIS, log det S and the count of the numbers of each row (N, M); infinite if the model fails."""
        if self.bar is not None:
            self.bar.update()
        try:
            unit, log_det, count = metrics.unit_innovations(self.filter_at(point), self.z)
        except (ValueError, FloatingPointError):
            return np.full((3, len(self.z), 1), math.inf)
        terms = np.array([np.square(unit).sum(axis=1), log_det, count])
        return terms if self.counts is None else np.where(self.counts[:, None], terms, 0.0)

    def of_rows(self, point: Array) -> Array:
        """Return the share of each row in -log L (N, M)."""
        nis, log_det, count = self._terms(point)
        return 0.5 * (nis + log_det + count * math.log(2 * math.pi))

    def __call__(self, point: Array) -> float:
        """Return -log L, infinite where the model cannot be computed."""
        key = point.tobytes()
        if key not in self.computed:
            self.computed[key] = float(self.of_rows(point).sum())
        return self.computed[key]

    def with_best_scale(self, point: Array, first: int = 0) -> tuple[float, float]:
        """Return the log c of the largest likelihood with c Q, c R and c P0, and -log L there: the profile likelihood.

        Gains and estimates do not depend on c, and each S becomes c S. So, with `count` measured numbers,

            -log L(c) = [Σ NIS / c + Σ log det S + count (log c + log 2π)] / 2

        has its minimum at c = Σ NIS / count. The sums begin at the row `first`.
        """
        nis, log_det, count = (float(each[first:].sum()) for each in self._terms(point))
        if count == 0 or not math.isfinite(nis):
            return 0.0, math.inf
        log_c = math.log(max(nis / count, MIN_SCALE))
        return log_c, 0.5 * (log_det + count * (log_c + 1 + math.log(2 * math.pi)))


def _filter_of(make, values):
    made = make(**values)
    if isinstance(made, LinearModel):
        return KalmanFilter(made)
    checks.instance("make", made, Filter)
    return made


def _search_along_ratio(likelihood, origin, n):
    """Return a point near the minimum, by a search over the ratio of two parameters such as q and r, or None.

    It applies where c times both parameters gives c Q and c R. Then `with_best_scale` gives the best c of each ratio.
    Since that scales P0 too, the first rows are skipped, and Newton's method refines the point.
    """
    if len(origin) != 2 or not _covariances_scale(likelihood, origin):
        return None
    first = min(START_ROWS_PER_STATE * n, len(likelihood.z) // 4)
    point = line_search(partial(likelihood.with_best_scale, first=first), origin, np.array([0.5, -0.5]))
    return point if math.isfinite(likelihood(point)) and _covariances_scale(likelihood, point) else None


def _covariances_scale(likelihood, point):
    """Tell whether doubling all parameters doubles Q and R of a Kalman filter and changes nothing else but P0."""
    one, two = (likelihood.filter_at(each) for each in (point, point + math.log(2)))
    if not (isinstance(one, KalmanFilter) and isinstance(two, KalmanFilter)) or (one.r is None) != (two.r is None):
        return False
    alike = [(getattr(one.model, name), getattr(two.model, name)) for name in ("F", "H", "x0")]
    alike.append((2 * one.model.Q, two.model.Q))
    alike.append((2 * one.model.R, two.model.R) if one.r is None else (2 * one.r, two.r))
    return same(one.t, two.t) and all(np.allclose(a, b, rtol=1e-9, atol=0, equal_nan=True) for a, b in alike)


@types_as_written
class Blocks(NamedTuple):
    """Parts of tracks whose scores count as independent: the block of each row (N, M), their number, and a name."""

    of_rows: np.ndarray
    count: int
    name: str


def blocks_of(estimator: Filter, z: Array) -> Blocks:
    """Return the Blocks of measurements z: the same number in each track, with equal numbers of fixes."""
    N, _, M = z.reshape(len(z), z.shape[1], -1).shape
    seen = np.isfinite(z).any(axis=1).reshape(N, M)
    fixes = seen.sum()
    if fixes < 2 * MIN_BLOCKS:
        return Blocks(np.zeros((N, M), int), 1, "curvature")
    # The smallest number of parts of each track that makes at least the wanted number of blocks.
    wanted = np.clip(fixes * _median_step(estimator, seen) / BLOCK_SECONDS, MIN_BLOCKS, MAX_BLOCKS)
    parts = math.ceil(wanted / M)
    before: np.ndarray = np.cumsum(seen, axis=0) - seen  # the fixes of a track before each row, (N, M)
    part = before * parts // np.maximum(seen.sum(axis=0), 1)
    block = np.minimum(part, parts - 1) + parts * np.arange(M)  # numbered along the first track, then the second, ...
    used, of_rows = np.unique(np.where(seen, block, block[seen][0]), return_inverse=True)  # only those with a fix
    count = len(used)
    name = f"{count} tracks" if parts == 1 else f"{count} blocks of {fixes / count:.0f} fixes"
    return Blocks(of_rows.reshape(N, M), count, name)


def _median_step(estimator, seen):
    """Return the median step between the fixes, seen (N, M), of a track in seconds."""
    t = np.broadcast_to(estimator.times_of(len(seen)).reshape(len(seen), -1), seen.shape)
    steps = np.concatenate([np.diff(t_of_one[seen_of_one]) for t_of_one, seen_of_one in zip(t.T, seen.T, strict=True)])
    return float(np.median(steps)) if len(steps) else 0.0


def log_errors(likelihood: NegativeLogLikelihood, best: Array, known: Array, blocks: Blocks) -> Array:
    """Return the standard errors (d,) of the logarithms of the parameters `known`, infinite for the others.

    They are the square roots of the diagonal of the sandwich H⁻¹ J H⁻¹: H holds the second derivatives of -log L, and J
    is the covariance of its gradient, estimated from the scores of the blocks.
    """

    def of_blocks(point):
        moved = best.copy()
        moved[known] = point
        shares = np.broadcast_to(likelihood.of_rows(moved), blocks.of_rows.shape)
        return np.bincount(blocks.of_rows.ravel(), shares.ravel(), blocks.count)

    errors = np.full(len(best), math.inf)
    if len(known):
        _, scores, H = finite_differences(of_blocks, best[known])  # (d, B) and (d, d, B) of B blocks
        H = H.sum(axis=-1)
        J = H if blocks.count == 1 else covariance_of_scores(scores)
        errors[known] = np.sqrt(_sandwich_diagonal(H, J))
    return errors


def covariance_of_scores(scores: Array) -> Array:
    """Return J (d, d) from the scores (d, B) of B blocks, which sum to zero; Student's factor allows for a small B."""
    count = scores.shape[1]
    student = stdtrit(count - 1, 0.975) / ndtri(0.975)
    return student**2 * count / (count - 1) * scores @ scores.T


def _sandwich_diagonal(H, J):
    """Return the diagonal (d,) of H⁻¹ J H⁻¹, infinite for parameters with a component along a flat direction of H."""
    if not (np.isfinite(H).all() and np.isfinite(J).all()):
        return np.full(len(H), math.inf)
    curvatures, directions = np.linalg.eigh(H)
    flat = curvatures <= FLAT_CURVATURE * max(curvatures[-1], 0)
    kept = directions[:, ~flat]
    inverse = kept / curvatures[~flat] @ kept.T
    moved = np.linalg.norm(directions[:, flat], axis=1)
    return np.where(moved > MAX_FLAT_COMPONENT, math.inf, np.diag(inverse @ J @ inverse))


def _towards_zero(likelihood, best, unit):
    """Return -log L where one parameter is a thousandth, or the smallest of a hundredth and a tenth that has one.

    A model may be refused far from its best value, as where the exponential of a matrix overflows. Infinite if all are.
    """
    tried = (likelihood(best - math.log(factor) * unit) for factor in (1000, 100, 10))
    return next((value for value in tried if math.isfinite(value)), math.inf)


def _warnings(found, z, guess, bounded, further):
    """Yield a warning for each undetermined parameter, and for whatever else looks wrong."""
    for (name, error), has_a_limit, there in zip(found.log_errors.items(), bounded, further, strict=True):
        if not has_a_limit:
            why = "does not fall" if math.isfinite(there) else "cannot be computed"
            yield f"{name}: the likelihood {why} as it goes to zero, so only an upper limit is known"
        elif error > UNKNOWN:
            yield f"{name}: the likelihood is flat, so z does not determine it, or only together with other parameters"
    if (distance := _distance_of_x0(found.filter, z)) > DOUBTFUL_START_DISTANCE:
        away = f"{distance:.0f} standard deviations from what x0 and P0 expect"
        yield f"the first measurements are {away}: the fit explains the distance as motion or noise"
    suspicions = metrics.suspicious(found.filter, z)
    yield from (suspicions[kind] for kind in ("far off", "same time") if kind in suspicions)
    if "far off" in suspicions:  # one fix has decided all values
        return
    for name, error in found.log_errors.items():
        times = found.values[name] / guess[name]
        if error < UNKNOWN and not 1 / SUSPICIOUS_RATIO < times < SUSPICIOUS_RATIO:
            units = "are z and t in the units of the guess (metres and seconds, not degrees, kilometres, milliseconds)?"
            yield f"{name}: {found.values[name]:.3g} is {times:.0e} times its guess: {units}"


def _distance_of_x0(estimator, z):
    """Return the distance of x0 from the best initial state of a track, in standard deviations: the largest of all.

    It is zero for other filters than Kalman. The innovations at unit covariance are linear in the initial state, so
    those from n + 1 states give e = e_0 - G d for any x0 + d.
    """
    if not isinstance(estimator, KalmanFilter):
        return 0.0
    model = estimator.model

    def innovations_from(x0):
        exact = replace(estimator, model=replace(model, x0=x0, P0=np.zeros_like(model.P0)))
        return metrics.unit_innovations(exact, z)

    e, _, count = innovations_from(model.x0)
    G = np.array([e - innovations_from(model.x0 + unit)[0] for unit in np.eye(model.n)])
    farthest = 0.0
    for track, measured in enumerate(count.sum(axis=0).tolist()):
        G_0 = G[..., track].reshape(model.n, -1).T
        farthest = max(farthest, _distance_of_start(e[..., track].ravel(), G_0, measured, model.P0))
    return farthest


def _distance_of_start(e, G, measured, P0):
    """Return the distance of d, the start by least squares from e = G d + noise, from zero in standard deviations.

    d has the covariance c V, and zero has P0. The residuals give the scale c, since a fit to a far start makes every S
    too large by the same factor. `measured` is the number of innovations; the others are zero.
    """
    n = len(P0)
    V = np.linalg.pinv(G.T @ G, hermitian=True)
    d = V @ G.T @ e
    c = np.sum((e - G @ d) ** 2) / (measured - n) if measured > n else 1.0
    squared = d @ np.linalg.pinv(P0 + c * V, hermitian=True) @ d
    return math.sqrt(max(squared, 0.0))  # rounding could make it negative
