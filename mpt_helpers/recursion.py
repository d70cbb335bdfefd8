"""Run x(k+1/k+1) = A_k x(k/k) + B_k z(k+1) over one track or many: the on-line half of every filter."""

import numpy as np

from . import checks


def measurements(z, m):
    """Check measurements and mark the missed epochs.

    z is (N, m) for one track or (N, m, M) for M tracks. A row that is all NaN is a missed epoch.

    Returns a copy of z with its missed rows set to zero, and the boolean `missed`, (N,) or (N, M). Raises ValueError
    for another shape, an empty or infinite z or a row that is only partly NaN, TypeError for data that are not real
    numbers.

    >>> measurements([[1.0], [np.nan]], m=1)
    (array([[1.],
           [0.]]), array([False,  True]))
    """
    need = f"an (N, {m}) or (N, {m}, M) array"
    z = checks.real("z", z, need)
    if z.ndim not in (2, 3) or z.shape[1] != m or 0 in z.shape:
        checks.refuse("z", need, f"shape {z.shape}" if z.ndim else "a scalar")
    lost = np.isnan(z)
    missed = lost.all(axis=1)
    partly = np.argwhere(lost.any(axis=1) & ~missed)
    if len(partly):
        row, *track = partly[0]
        place = f"row {row}" + "".join(f" of track {t}" for t in track)
        checks.refuse("z", "rows that are all numbers or all NaN (a missed epoch)", f"{place} partly NaN")
    z[lost] = 0
    return z, missed


def run(coefficients, z, missed, x0):
    """Run the recursion.

    coefficients maps the missed epochs, a boolean array (N,), to A (N, n, n) and B (N, n, m); z and missed are those of
    `measurements`; x0 is x(0/0), of length n. Tracks that miss the same epochs share their coefficients.

    Returns the estimates, (N, n) or (N, n, M): row k is x(k+1/k+1).

    >>> halves = lambda missed: (np.full((len(missed), 1, 1), 0.5), np.full((len(missed), 1, 1), 0.5))
    >>> run(halves, *measurements([[1.0], [1.0]], m=1), np.zeros(1))
    array([[0.5 ],
           [0.75]])
    """
    if z.ndim == 2:
        return run(coefficients, z[..., None], missed[:, None], x0)[..., 0]
    N, _, M = z.shape
    packed = np.ascontiguousarray(np.packbits(missed, axis=0).T)  # one short string of bytes for each track: sorts fast
    _, first, pattern_of = np.unique(packed.view(f"V{packed.shape[1]}"), return_index=True, return_inverse=True)
    if len(first) == 1:
        return _steps(*coefficients(missed[:, 0]), z, x0[:, None])
    x = np.empty((N, len(x0), M))
    for i, track in enumerate(first):
        tracks = pattern_of.ravel() == i
        x[..., tracks] = _steps(*coefficients(missed[:, track]), z[..., tracks], x0[:, None])
    return x


def _steps(A, B, z, x0):
    x = B @ z
    previous = x0
    for A_k, x_k in zip(A, x, strict=True):
        x_k += A_k @ previous
        previous = x_k
    return x
