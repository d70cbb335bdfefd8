"""The filters of the papers, side by side.

Each one is x(k+1/k+1) = A_k x(k/k) + B_k z(k+1), and no A_k, B_k depends on the measurements: they differ only in how
the coefficients are made. A missed epoch is predicted only: A_k = F, B_k = 0.

Every `filter(z)` takes z of shape (N, m) or (N, m, M), z[0] being z(1), and returns (N, n) or (N, n, M), row k being
x(k+1/k+1). It raises ValueError or TypeError for measurements of another shape or kind (see `recursion.measurements`).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import filterpy.kalman
import numpy as np

from . import checks, riccati
from .model import LinearModel, predicted_covariance, square_root, stack
from .recursion import measurements, run


class Coefficients(NamedTuple):
    """A (N, n, n), B (N, n, m) and the error covariance P (N, n, n) of steps 1 to N."""

    A: np.ndarray
    B: np.ndarray
    P: np.ndarray


@dataclass(frozen=True, eq=False)
class _Recursive:
    """What every filter with coefficients shares.

    A subclass has a `_stepper()`, which makes a function that takes P(k/k) and whether epoch k+1 is missed, and returns
    A_k, B_k and P(k+1/k+1).
    """

    model: LinearModel

    def __post_init__(self):
        checks.instance("model", self.model, LinearModel)

    def filter(self, z):
        """Return the estimates x(1/1) ... x(N/N) of one track or many."""
        z, missed = measurements(z, self.model.m)
        return run(lambda missed: self._coefficients(missed)[:2], z, missed, self.model.x0)

    def coefficients(self, N):
        """Return the coefficients A, B and the covariance P of steps 1 to N, with no epoch missed."""
        return self._coefficients(np.zeros(checks.count("N", N), bool))

    def covariances(self, N):
        """Return P(1/1) ... P(N/N), (N, n, n)."""
        return self.coefficients(N).P

    def _coefficients(self, missed):
        N, n, m = len(missed), self.model.n, self.model.m
        A, B, P = np.empty((N, n, n)), np.empty((N, n, m)), np.empty((N, n, n))
        step = self._stepper()
        for k, lost in enumerate(missed):
            if k > 1 and lost == missed[k - 1] and np.array_equal(P[k - 1], P[k - 2]):
                A[k], B[k], P[k] = A[k - 1], B[k - 1], P[k - 1]  # steady to the last bit: the step repeats itself
            else:
                A[k], B[k], P[k] = step(P[k - 1] if k else self.model.P0, lost)
        return Coefficients(A, B, P)


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
            A = riccati.lainiotis_gain(P, Fn, On)
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
        object.__setattr__(self, "P", checks.array("P", self.P, (n, n)))

    def _coefficients(self, missed):
        lost = missed[:, None, None]
        P = np.broadcast_to(self.P, (len(missed), *self.P.shape))
        return Coefficients(np.where(lost, self.model.F, self.A), np.where(lost, 0, self.B), P)


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
    ValueError for a model whose F has no inverse.

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
        F_N = np.linalg.matrix_power(model.F, steps)
        P = predicted_covariance(model, steady.P, steps)
        A_N = np.linalg.solve(F_N.T, (F_N @ steady.A).T).T
        super().__init__(replace(model, x0=F_N @ model.x0), A=A_N, B=F_N @ steady.B, P=(P + P.T) / 2)
        object.__setattr__(self, "steps", steps)


@dataclass(frozen=True)
class JoinFilter:
    """Two filters on the same measurements, half the weight each: JKLF and JSSKLF (2014 Eqs. 8, 16; 2015 Eqs. 4-5, 13).

    Raises ValueError when the two models differ.

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
            _require_filter(name, getattr(self, name))
        if self.first.model != self.second.model:
            checks.refuse("second", "a filter of the same model as the first", "one of another model")

    @property
    def model(self):
        """The model of both filters."""
        return self.first.model

    def filter(self, z):
        """Return the mean of both estimates."""
        return (self.first.filter(z) + self.second.filter(z)) / 2

    def covariances(self, N):
        """Return the mean of both covariances, (N, n, n)."""
        return (self.first.covariances(N) + self.second.covariances(N)) / 2


class Separate:
    """Filters side by side, each on its own part of the state: model B of the papers (2014 Section 5, Eqs. 17-18).

    Raises ValueError when no filter is given.

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
            _require_filter(f"filters[{i}]", each)
        self.filters = filters

    @property
    def model(self):
        """The stacked model: model A."""
        return stack(*(each.model for each in self.filters))

    def filter(self, z):
        """Return the estimates of all filters, joined end to end."""
        measurements(z, self.model.m)
        ends = np.cumsum([each.model.m for each in self.filters])
        parts = np.split(np.asarray(z), ends[:-1], axis=1)
        return np.concatenate([each.filter(part) for each, part in zip(self.filters, parts, strict=True)], axis=1)

    def covariances(self, N):
        """Return the block diagonal covariances, (N, n, n)."""
        model = self.model
        P = np.zeros((checks.count("N", N), model.n, model.n))
        end = 0
        for each in self.filters:
            start, end = end, end + each.model.n
            P[:, start:end, start:end] = each.covariances(N)
        return P


def fir_order(A, tol, norm=2):
    """Return the FIR order M: ‖Aᴹ‖ < tol and ‖Aᴹ⁻¹‖ >= tol for the first time (2014 Section 7).

    A is n×n, tol is the paper's ε, norm is what `numpy.linalg.norm` takes: 2 is the spectral norm. Raises ValueError
    for tol outside (0, 1] (‖A⁰‖ >= tol must hold) or an A that does not decay.

    >>> fir_order([[0.5]], tol=0.1)
    4
    """
    A = checks.matrix("A", A, "a square matrix")
    A = checks.array("A", A, (len(A), len(A)))
    tol = checks.number("tol", tol, "a number in (0, 1]", lambda tol: 0 < tol <= 1)
    radius = np.abs(np.linalg.eigvals(A)).max()
    if radius >= 1:
        checks.refuse("A", "a spectral radius below 1", f"{radius:.6g}")
    M, power = 1, A
    while np.linalg.norm(power, norm) >= tol:
        M, power = M + 1, power @ A
    return M


@dataclass(frozen=True, eq=False)
class FIRFilter:
    """The finite impulse response form of a steady-state filter (2014 Eq. 22): taps Aʲ B on the last M measurements.

        x(k/k) = sum over j = 0 ... M-1 of Aʲ B z(k-j)

    taps is (M, n, m). Measurements before z(1) count as zero, and x0 enters only where there is no estimate before a
    missed epoch. A missed epoch is predicted only, and its measurement replaced by the predicted one, H F x(k-1/k-1):
    that is what a missed epoch does to the steady-state filter.

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
        F, H, x0 = self.model.F, self.model.H, self.model.x0[:, None]
        x = np.zeros((len(z), self.model.n, z.shape[2]))
        for j, tap in enumerate(self.taps[: len(z)]):
            x[j:] += tap @ z[: len(z) - j]
        for k in np.flatnonzero(missed.any(axis=1)):
            predicted = F @ (x[k - 1] if k else x0)
            x[k : k + self.order] += self.taps[: len(z) - k] @ np.where(missed[k], H @ predicted, 0)
            x[k] = np.where(missed[k], predicted, x[k])
        return x


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


def _require_filter(name, value):
    if not isinstance(value, (_Recursive, JoinFilter, Separate, FIRFilter)):
        checks.refuse(name, "a filter", f"{type(value).__name__} {value!r:.40}", TypeError)
