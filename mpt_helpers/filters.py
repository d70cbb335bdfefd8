"""The filters of the papers, side by side.

Each one is x(k+1/k+1) = A_k x(k/k) + B_k z(k+1), and no A_k, B_k depends on the measurements: they differ only in how
the coefficients are made. A missed epoch is predicted only: A_k = F, B_k = 0.

Every `filter(z)` takes z of shape (N, m) or (N, m, M), z[0] being z(1), and returns (N, n) or (N, n, M), row k being
x(k+1/k+1). It raises ValueError or TypeError for measurements of another shape or kind (see `recursion.measurements`).
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from threading import Lock
from typing import NamedTuple

import filterpy.kalman
import numpy as np
from scipy.linalg import block_diag

from . import checks, riccati
from .model import LinearModel, predicted_covariance, square_root, stack
from .recursion import System, lift, measurements, run, shaped, tiles

# What F⁻ᴺ may cost A_N, at unit variances: runs of several steps in one product lose up to some thousand times as much.
INVERSE_LOSES = 1e-9


class Coefficients(NamedTuple):
    """A (N, n, n), B (N, n, m) and the error covariance P (N, n, n) of steps 1 to N."""

    A: np.ndarray
    B: np.ndarray
    P: np.ndarray


class _Linear:
    """What every filter is: s(k+1) = A_k s(k) + B_k z(k+1), the first n entries of s being the estimate.

    A subclass has a model, `_system(missed)`, which returns the recursion.System for the missed epochs, (N,), and
    `_start`, which is s(0). `steps` is how far ahead its estimates are.
    """

    steps = 0

    def filter(self, z):
        """Return the estimates x(1/1) ... x(N/N) of one track or many."""
        model = self.model
        return run(self._blocks, shaped(z, model.m), self._start, model.n)

    @property
    def _start(self):
        return self.model.x0

    def _blocks(self, missed, L):
        return self._lifted(missed.tobytes(), L)

    @cached_property
    def _lifted(self):
        @lru_cache(maxsize=4)  # a filter that runs again over as many steps has its coefficients ready
        def lifted(missed, L):
            return lift(self._system(np.frombuffer(missed, bool)), L, self.model.n)

        return lifted

    def __getstate__(self):
        """Leave out what is made anew in another process."""
        return {name: value for name, value in vars(self).items() if name not in ("_lifted", "_step")}


@dataclass(frozen=True, eq=False)
class _Recursive(_Linear):
    """What every filter with coefficients of its own shares: s is the estimate.

    A subclass has a `_stepper()`, which makes a function that takes P(k/k) and whether epoch k+1 is missed, and returns
    A_k, B_k and P(k+1/k+1).
    """

    model: LinearModel

    def __post_init__(self):
        checks.instance("model", self.model, LinearModel)

    @property
    def P_0(self):
        """P(0/0), the covariance that the recursion starts from: P0 of the model."""
        return self.model.P0

    def coefficients(self, N):
        """Return the coefficients A, B and the covariance P of steps 1 to N, with no epoch missed."""
        steps, of = self._steps(np.zeros(checks.count("N", N), bool))
        return Coefficients(*(each[of] for each in steps))

    def covariances(self, N):
        """Return P(1/1) ... P(N/N), (N, n, n)."""
        return self.coefficients(N).P

    def _system(self, missed):
        (A, B, _), of = self._steps(missed)
        return System(A, B, of)

    def _steps(self, missed):
        """Return the Coefficients of the distinct steps, and which of them each epoch takes.

        A step depends on P(k/k) and on whether the epoch is missed, and P soon repeats itself to the last bit: a step
        that was made once is not made again.
        """
        rows, of = {}, np.empty(len(missed), int)
        ends = np.append(np.flatnonzero(np.diff(missed)) + 1, len(missed))
        k, P = 0, self.model.P0.tobytes()
        while k < len(missed):
            here = P, bool(missed[k])
            row, step = rows.setdefault(here, (len(rows), self._step(*here)))
            P = step.P.tobytes()
            end = ends[np.searchsorted(ends, k, "right")] if here[0] == P else k + 1
            of[k:end] = row
            k = end
        return Coefficients(*map(np.array, zip(*(step for _, step in rows.values()), strict=True))), of

    @cached_property
    def _step(self):
        step, lock, n = self._stepper(), Lock(), self.model.n

        @lru_cache(maxsize=4096)
        def remembered(P, lost):
            with lock:  # filterpy's object has a state
                return Coefficients(*map(np.array, step(np.frombuffer(P).reshape(n, n), lost)))

        return remembered


class KalmanFilter(_Recursive):
    """The Kalman filter (2014 Eq. 4, 2015 Eq. 1): gains and covariances are those of filterpy's KalmanFilter.

        A_k = (I - K_k H) F,   B_k = K_k

    >>> from mpt_helpers.model import gsm_axis
    >>> KalmanFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def _stepper(self):
        # What filterpy 2.0 gets wrong is avoided here, and tests/test_filterpy.py watches each trap: a fresh object for
        # each run (its state survives a run), x of one dimension (with a column x a vector z raises), full matrices (a
        # scalar R is added to every entry of S), H set on the object (passed to update it changes the shape of x), a
        # missed epoch as None (NaN poisons every later state, and None leaves the gain of the last update in K).
        F, H = self.model.F, self.model.H
        kf = filterpy.kalman.KalmanFilter(dim_x=self.model.n, dim_z=self.model.m)
        kf.F, kf.H, kf.Q, kf.R = F, H, self.model.Q, self.model.R

        def step(P, lost):
            kf.x, kf.P = self.model.x0, P  # neither gain nor covariance depends on x
            kf.predict()
            kf.update(None if lost else np.zeros(self.model.m))
            K = np.zeros_like(kf.K) if lost else kf.K
            return (np.eye(self.model.n) - K @ H) @ F, K, kf.P

        return step


class LainiotisFilter(_Recursive):
    """The Lainiotis filter (2014 Eqs. 5-7, 2015 Eqs. 2-3).

        A_k = F_n [I + P(k/k) O_n]⁻¹,   B_k = K_n + A_k P(k/k) K_m,   P(k+1/k+1) = P_n + A_k P(k/k) F_nᵀ

    >>> from mpt_helpers.model import gsm_axis
    >>> LainiotisFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def _stepper(self):
        F, Q = self.model.F, self.model.Q
        Fn, Kn, Km, Pn, On = riccati.lainiotis_matrices(self.model)

        def step(P, lost):
            if lost:
                return F, np.zeros_like(Kn), F @ P @ F.T + Q
            A = riccati._gain(P, Fn, On)  # P may be infinite: that of a track which misses very much
            following = Pn + A @ P @ Fn.T
            return A, Kn + A @ P @ Km, (following + following.T) / 2

        return step


@dataclass(frozen=True, eq=False)
class _Constant(_Recursive):
    """What every filter with constant coefficients shares: A (n×n), B (n×m) and its error covariance P (n×n)."""

    A: np.ndarray
    B: np.ndarray
    P: np.ndarray

    def __post_init__(self):
        super().__post_init__()
        n, m = self.model.n, self.model.m
        object.__setattr__(self, "A", checks.array("A", self.A, (n, n)))
        object.__setattr__(self, "B", checks.array("B", self.B, (n, m)))
        object.__setattr__(self, "P", checks.covariance("P", self.P, n, rounding=checks.COMPUTED))

    @property
    def P_0(self):
        """P(0/0), which is that of the steady state."""
        return self.P

    def _steps(self, missed):
        both = np.array([self.A, self.model.F]), np.array([self.B, np.zeros_like(self.B)]), np.array([self.P, self.P])
        return Coefficients(*both), missed.astype(int)


class SteadyStateFilter(_Constant):
    """A filter whose coefficients are constant: A (n×n), B (n×m), and its estimation error covariance P (n×n).

    2014 Eqs. 9-15, 2015 Eqs. 6-12, 2016 Eqs. 8-12. Made by `from_kalman` or `from_lainiotis`, which solve different
    Riccati equations: that they agree (2014 Eq. 15) is a result.

    >>> from mpt_helpers.model import gsm_axis
    >>> SteadyStateFilter.from_kalman(gsm_axis(dt=1.0, q=0.01, r=0.1)).B.round(4)
    array([[0.3654],
           [0.2068]])
    """

    @classmethod
    def from_kalman(cls, model):
        """Solve the Riccati equation of the Kalman filter, then A = (I - K H) F and B = K (2014 Eqs. 10-11).

        Raises ValueError when the model has no steady state, naming the condition that fails and the mode.
        """
        P = riccati.rekf(model)
        H, R = model.H, model.R
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        update = np.eye(model.n) - K @ H
        root = np.hstack([update @ square_root(P), K @ np.linalg.cholesky(R)])  # of the Joseph form of P_e
        return cls(model, A=update @ model.F, B=K, P=root @ root.T)

    @classmethod
    def from_lainiotis(cls, model):
        """Solve the Riccati equation of the Lainiotis filter, then A and B of 2014 Eqs. 13-14.

        Raises ValueError when the model has no steady state, naming the condition that fails and the mode.
        """
        P = riccati.relf(model)
        Fn, Kn, Km, _, On = riccati.lainiotis_matrices(model)
        A = riccati.lainiotis_gain(P, Fn, On)
        return cls(model, A=A, B=Kn + A @ P @ Km, P=P)


class SteadyStatePredictor(_Constant):
    """The steady-state prediction N steps ahead (2016 Eqs. 15-20): row k of `filter(z)` is x(k+1+N / k+1).

        x(k+N/k) = A_N x(k+N-1/k-1) + B_N z(k),   A_N = Fᴺ A F⁻ᴺ,   B_N = Fᴺ B,   x(N/0) = Fᴺ x0

    steady is the SteadyStateFilter whose A and B these are, steps is N; with N = 0 it is that filter. P is the
    covariance of the prediction's error: P(k+N/k) = F P(k+N-1/k) Fᵀ + Q, from the P of the filter.

    Raises TypeError or ValueError for anything but a steady-state filter and a whole number that is not negative, and
    ValueError for a model whose F has no inverse and for so many steps that F⁻ᴺ leaves fewer than six digits.

    >>> from mpt_helpers.model import constant_velocity
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> SteadyStatePredictor(steady, steps=3).filter([[1.0], [2.0]]).round(4)
    array([[1.186 , 0.2125],
           [2.8678, 0.4757]])
    """

    def __init__(self, steady, steps):
        model = checks.instance("steady", steady, SteadyStateFilter).model
        steps = checks.count("steps", steps, least=0)
        sigma = np.sqrt(np.diag(predicted_covariance(model, steady.P, 1)))
        unit = np.where(sigma > 0, sigma, 1)  # in these units the entries of F can be compared
        if np.linalg.matrix_rank(model.F * unit / unit[:, None]) < model.n:
            checks.refuse("steady", "a model whose F has an inverse", "a singular F")
        with np.errstate(over="ignore", invalid="ignore"):  # of too many steps
            F_N = np.linalg.matrix_power(model.F, steps)
            P = predicted_covariance(model, steady.P, steps)
        try:
            A_N = np.linalg.solve(F_N.T, (F_N @ steady.A).T).T
            lost = (np.linalg.solve(F_N, A_N @ F_N) - steady.A) * unit / unit[:, None]
        except np.linalg.LinAlgError:
            lost = np.inf
        if not np.abs(lost).max() <= INVERSE_LOSES:
            checks.refuse("steps", "so few that the inverse of F to that power keeps six digits", steps)
        super().__init__(replace(model, x0=F_N @ model.x0), A=A_N, B=F_N @ steady.B, P=(P + P.T) / 2)
        object.__setattr__(self, "steps", steps)


@dataclass(frozen=True)
class JoinFilter(_Linear):
    """Two filters on the same measurements, half the weight each: JKLF and JSSKLF (2014 Eqs. 8, 16; 2015 Eqs. 4-5, 13).

    Raises ValueError when the two models differ, or how far ahead the two predict, TypeError for what is no filter.

    >>> from mpt_helpers.model import gsm_axis
    >>> axis = gsm_axis(dt=1.0, q=0.01, r=0.1)
    >>> JoinFilter(KalmanFilter(axis), LainiotisFilter(axis)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    first: object
    second: object

    def __post_init__(self):
        for name in ("first", "second"):
            require_filter(name, getattr(self, name))
        if self.first.model != self.second.model:
            checks.refuse("second", "a filter of the same model as the first", "one of another model")
        if self.first.steps != self.second.steps:
            need, got = (f"a filter {each.steps} steps ahead" for each in (self.first, self.second))
            checks.refuse("second", f"{need}, as the first", got)

    @property
    def steps(self):
        """How far ahead both filters predict."""
        return self.first.steps

    @property
    def model(self):
        """The model of both filters."""
        return self.first.model

    @property
    def P_0(self):
        """The mean of both P(0/0)."""
        return (self.first.P_0 + self.second.P_0) / 2

    def covariances(self, N):
        """Return the mean of both covariances, (N, n, n)."""
        for name in ("first", "second"):
            require_covariances(name, getattr(self, name))
        return (self.first.covariances(N) + self.second.covariances(N)) / 2

    @property
    def _halves(self):
        """What makes (x_1 + x_2)/2 and (x_1 - x_2)/2 of x_1 and x_2, and leaves the rest of both states as it is."""
        n, first, both = self.model.n, len(self.first._start), len(self.first._start) + len(self.second._start)
        T = np.eye(both)
        one, two = np.arange(n), first + np.arange(n)
        T[one, one], T[one, two], T[two, one], T[two, two] = 0.5, 0.5, 0.5, -0.5
        return T

    @property
    def _start(self):
        return self._halves @ np.concatenate([self.first._start, self.second._start])

    def _system(self, missed):
        (A, B), of = _together([each._system(missed) for each in (self.first, self.second)])
        T = self._halves
        return System(T @ _diagonal(A) @ np.linalg.inv(T), T @ np.concatenate(B, axis=1), of)


class Separate(_Linear):
    """Filters side by side, each on its own part of the state: model B of the papers (2014 Section 5, Eqs. 17-18).

    Raises ValueError when no filter is given or they predict differently far ahead, TypeError for what is no filter.

    >>> from mpt_helpers.model import gsm_axis
    >>> kf = KalmanFilter(gsm_axis(dt=1.0, q=0.01, r=0.1))
    >>> Separate(kf, kf).filter([[1.0, 1.0], [2.0, 0.0]]).round(4)
    array([[0.0612, 0.1224, 0.0612, 0.1224],
           [0.5557, 0.4681, 0.1164, 0.06  ]])
    """

    def __init__(self, *filters):
        if not filters:
            checks.refuse("filters", "at least one filter", "none")
        for i, each in enumerate(filters):
            require_filter(f"filters[{i}]", each)
        if len(ahead := sorted({each.steps for each in filters})) > 1:
            checks.refuse("filters", "filters that predict equally far ahead", f"steps {ahead}")
        self.filters, self.steps = filters, *ahead

    @cached_property
    def model(self):
        """The stacked model: model A."""
        return stack(*(each.model for each in self.filters))

    @property
    def P_0(self):
        """The block diagonal P(0/0)."""
        return block_diag(*(each.P_0 for each in self.filters))

    def covariances(self, N):
        """Return the block diagonal covariances, (N, n, n)."""
        checks.count("N", N)
        for i, each in enumerate(self.filters):
            require_covariances(f"filters[{i}]", each)
        return _diagonal([each.covariances(N) for each in self.filters])

    @property
    def _order(self):
        """The places of all estimates among the states joined end to end, then the places of the rest."""
        rest = np.concatenate([np.arange(len(each._start)) >= each.model.n for each in self.filters])
        return np.argsort(rest, kind="stable")

    @property
    def _start(self):
        return np.concatenate([each._start for each in self.filters])[self._order]

    def _system(self, missed):
        (A, B), of = _together([each._system(missed) for each in self.filters])
        order = self._order
        return System(_diagonal(A)[:, order[:, None], order], _diagonal(B)[:, order], of)


def _together(systems):
    """Return the A's and the B's of several systems for each combination of their steps, and which each epoch takes."""
    of = np.zeros(len(systems[0].of), int)
    for each in systems:  # numbered anew each time: the product of all their steps may be more than an integer holds
        _, first, of = np.unique(of * len(each.A) + each.of, return_index=True, return_inverse=True)
    return zip(*((each.A[each.of[first]], each.B[each.of[first]]) for each in systems), strict=True), of


def _diagonal(blocks):
    """Return the block diagonal matrices (U, Σ rows, Σ columns) of matrices (U, rows, columns)."""
    rows, columns = (np.cumsum([0, *(each.shape[axis] for each in blocks)]) for axis in (1, 2))
    D = np.zeros((len(blocks[0]), rows[-1], columns[-1]))
    for i, each in enumerate(blocks):
        D[:, rows[i] : rows[i + 1], columns[i] : columns[i + 1]] = each
    return D


def fir_order(A, tol, norm=2):
    """Return the FIR order M: ‖Aᴹ‖ < tol and ‖Aᴹ⁻¹‖ >= tol for the first time (2014 Section 7).

    A is n×n, tol is the paper's ε, norm is 1, 2 (the spectral norm), inf, "fro" or "nuc", as in `numpy.linalg.norm`.
    Raises ValueError for tol outside (0, 1] (‖A⁰‖ >= tol must hold), an A that does not decay or what is no norm.

    >>> fir_order([[0.5]], tol=0.1)
    4
    """
    A = checks.matrix("A", A, "a square matrix")
    A = checks.array("A", A, (len(A), len(A)))
    tol = checks.number("tol", tol, "a number in (0, 1]", lambda tol: 0 < tol <= 1)
    checks.one_of("norm", norm, (1, 2, np.inf, "fro", "nuc"))
    radius = np.abs(np.linalg.eigvals(A)).max()
    if radius >= 1:
        checks.refuse("A", "a spectral radius below 1", f"{radius:.6g}")
    M, power = 1, A
    while np.linalg.norm(power, norm) >= tol:
        M, power = M + 1, power @ A
    return M


@dataclass(frozen=True, eq=False)
class FIRFilter(_Linear):
    """The finite impulse response form of a steady-state filter (2014 Eq. 22): taps Aʲ B on the last M measurements.

        x(k/k) = sum over j = 0 ... M-1 of Aʲ B z(k-j)

    taps is (M, n, m). Measurements before z(1) count as zero, and x0 enters only where there is no estimate before a
    missed epoch. A missed epoch is predicted only, and its measurement replaced by the predicted one, H F x(k-1/k-1):
    that is what a missed epoch does to the steady-state filter. It has no covariances.

    Raises TypeError or ValueError for anything but a model and such an array.

    >>> from mpt_helpers.model import gsm_axis
    >>> steady = SteadyStateFilter.from_kalman(gsm_axis(dt=1.0, q=0.01, r=0.1))
    >>> FIRFilter.from_steady_state(steady, tol=1e-3).order
    17
    """

    model: LinearModel
    taps: np.ndarray

    def __post_init__(self):
        checks.instance("model", self.model, LinearModel)
        taps = checks.real("taps", self.taps, "an (M, n, m) array")
        if taps.ndim != 3 or taps.shape[1:] != self.model.H.T.shape or not len(taps) or np.isnan(taps).any():
            need = f"an (M, {self.model.n}, {self.model.m}) array without NaN"
            checks.refuse("taps", need, f"NaN or shape {taps.shape}")
        taps.flags.writeable = False
        object.__setattr__(self, "taps", taps)

    @classmethod
    def from_steady_state(cls, steady, tol=1e-3):
        """Cut the impulse response Aʲ B of a steady-state filter where the spectral norm of Aᴹ falls below tol."""
        checks.instance("steady", steady, SteadyStateFilter)
        taps = [steady.B]
        for _ in range(fir_order(steady.A, tol) - 1):
            taps.append(steady.A @ taps[-1])
        return cls(steady.model, np.array(taps))

    @property
    def order(self):
        """The paper's M: how many measurements an estimate takes."""
        return len(self.taps)

    def filter(self, z):
        """Return the estimates x(1/1) ... x(N/N) of one track or many."""
        z, missed = measurements(z, self.model.m)
        if z.ndim == 2:
            return self._convolve(z[..., None], missed[:, None])[..., 0]
        return self._convolve(z, missed)

    def _convolve(self, z, missed):
        """Several steps at once: the taps, shifted, as one matrix times the measurements that these steps take."""
        (N, m, M), n = z.shape, self.model.n
        L, before = min(8, N), self.order - 1
        T = np.zeros((L, n, before + L, m))
        for i in range(L):
            T[i, :, i : i + self.order] = self.taps[::-1].swapaxes(0, 1)
        T = T.reshape(L * n, -1)
        x, z = np.empty((N * n, M)), z.reshape(N * m, M)
        for tile in tiles(M):
            for k in range(0, N, L):
                start, end = max(k - before, 0), min(k + L, N)
                taps = T[: (end - k) * n, (start - k + before) * m : (end - k + before) * m]
                np.matmul(taps, z[start * m : end * m, tile], out=x[k * n : end * n, tile])
        x = x.reshape(N, n, M)
        F, H, x0 = self.model.F, self.model.H, self.model.x0[:, None]
        for k in np.flatnonzero(missed.any(axis=1)):
            predicted = F @ (x[k - 1] if k else x0)
            x[k : k + self.order] += self.taps[: N - k] @ np.where(missed[k], H @ predicted, 0)
            x[k] = np.where(missed[k], predicted, x[k])
        return x

    @property
    def _start(self):
        return np.concatenate([self.model.x0, np.zeros(self.order * self.model.m)])

    def _system(self, missed):
        """Return the same as a recursion, for JoinFilter and Separate: s is x(k/k) and the last M measurements."""
        n, m, p = self.model.n, self.model.m, len(self._start)
        A, B = np.zeros((2, p, p)), np.zeros((2, p, m))
        A[:, n + m :, n : p - m] = np.eye(p - n - m)
        A[0, :n, n : p - m], B[0, :n] = np.hstack([np.empty((n, 0)), *self.taps[1:]]), self.taps[0]
        B[0, n : n + m] = np.eye(m)
        A[1, :n, :n], A[1, n : n + m, :n] = self.model.F, self.model.H @ self.model.F
        return System(A, B, missed.astype(int))


def six_filters(model):
    """Return the six filters of the papers by their names (2014 Table 1, 2015 Table 1), in the papers' order.

    Raises ValueError when the model has no steady state.

    >>> from mpt_helpers.model import gsm_axis
    >>> list(six_filters(gsm_axis(dt=1.0, q=0.01, r=0.1)))
    ['KF', 'LF', 'JKLF', 'SSKF', 'SSLF', 'JSSKLF']
    """
    kf, lf = KalmanFilter(model), LainiotisFilter(model)
    sskf, sslf = SteadyStateFilter.from_kalman(model), SteadyStateFilter.from_lainiotis(model)
    join, join_steady = JoinFilter(kf, lf), JoinFilter(sskf, sslf)
    return {"KF": kf, "LF": lf, "JKLF": join, "SSKF": sskf, "SSLF": sslf, "JSSKLF": join_steady}


def require_filter(name, value):
    """Return `value` if it is a filter, or raise a TypeError."""
    if not isinstance(value, _Linear):
        checks.refuse(name, "a filter", checks.kind_of(value), TypeError)
    return value


def require_covariances(name, value):
    """Return `value` if it is a filter that states its covariances, or raise a TypeError."""
    if isinstance(value, type) or not (hasattr(value, "filter") and hasattr(value, "covariances")):
        checks.refuse(name, "a filter that states its covariances", checks.kind_of(value), TypeError)
    return value
