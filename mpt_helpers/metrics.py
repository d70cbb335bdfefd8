"""How far estimates lie from each other and from the truth."""

import numpy as np

from . import checks


def relative_gap(a, b):
    """Return the largest difference between two arrays of one shape, relative to the largest entry of the second.

    >>> relative_gap([1.0, 2.0], [1.0, 4.0])
    0.5
    """
    a, b = checks.real("a", a, "an array"), checks.real("b", b, "an array")
    if a.shape != b.shape or not b.any():
        checks.refuse("a", "the shape of b, which is not all zero", f"{a.shape}, b {b.shape}")
    return float(np.abs(a - b).max() / np.abs(b).max())


def largest_gaps(reference, others, z):
    """Return how far other filters are from one on the same measurements (N, m), in estimates and in covariances.

    Both are the largest over the others, the steps and the components: of the estimates relative to the largest
    estimate of that component, of the covariances relative to the standard deviations of both components at that step.
    """
    x, P = reference.filter(z), reference.covariances(len(z))
    sigma = np.sqrt(np.einsum("kii->ki", P))
    x_gap = max(np.abs((each.filter(z) - x) / np.abs(x).max(axis=0)).max() for each in others)
    P_gap = max(np.abs((each.covariances(len(z)) - P) / sigma[:, :, None] / sigma[:, None, :]).max() for each in others)
    return float(x_gap), float(P_gap)


def rms(values, axis=None):
    """Return the root mean square along an axis, or of all.

    >>> rms([3.0, -3.0])
    3.0
    """
    square = np.mean(np.square(values), axis=axis)
    return float(np.sqrt(square)) if axis is None else np.sqrt(square)
