"""The measurements of all tracks with the conditions under which they were made: one value, checked once, on entry.

The conditions of an epoch are which measurements are there, how long the step before it was, and how precise they are.
A filter makes `Epochs` of what it is given; what runs it afterwards knows nothing else of times and variances.

Tracks lie in columns. Where all tracks share their conditions they share their covariances too, and lie in one column;
otherwise each is a column of its own. `Epochs.layout` decides that; only a gate asks for columns of their own in any
case. All arrays are laid out by the `Layout`. Here the second of two tracks misses its second measurement, so that each
track is a column:

>>> z = np.array([[1.0, 5.0], [2.0, np.nan], [3.0, 7.0]])[:, None]  # (N, m, M): 3 epochs, 1 measurement, 2 tracks
>>> epochs = Epochs(z)
>>> epochs.layout
Layout(one_column=False)
>>> _, second, _ = epochs.layout.rows(epochs)
>>> second.z, second.seen  # (m, c, columns) and (m, columns): one track in each of two columns
(array([[[2., 0.]]]), array([[ True, False]]))

With the same gaps they lie in one column, and are seen or missing together:

>>> epochs = Epochs(z[:1])
>>> epochs.layout
Layout(one_column=True)
>>> (first,) = epochs.layout.rows(epochs)
>>> first.z, first.seen  # two tracks in one column
(array([[[1.],
        [5.]]]), array([[ True]]))
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np


class Row(NamedTuple):
    """One epoch of all columns, in the shapes of `Rows` without the first axis."""

    z: np.ndarray
    seen: np.ndarray
    lengths: np.ndarray | None
    variances: np.ndarray | None

    def without(self, refused):
        """Return the Row with nothing measured in the columns that `refused` (M,) says."""
        return self._replace(z=np.where(refused, 0, self.z), seen=self.seen & ~np.asarray(refused))


@dataclass(frozen=True)
class Rows:
    """The epochs of c tracks in each of M columns, one row after the other.

    z (N, m, c, M) is zero where a measurement is missing, and seen (N, m, M) tells which are there. lengths (N, M) are
    those of the steps before each epoch, in units of the model's dt, or None where all are one. variances
    (N, m, M) are those of the measurements, or None where they are the model's.
    """

    z: np.ndarray
    seen: np.ndarray
    lengths: np.ndarray | None = None
    variances: np.ndarray | None = None

    def __iter__(self):
        """Yield one Row after the other."""
        for k in range(len(self.z)):
            yield Row(self.z[k], self.seen[k], *(None if a is None else a[k] for a in (self.lengths, self.variances)))

    def mapped(self, function):
        """Return the Rows of function(array) for each array."""
        arrays = (self.z, self.seen, self.lengths, self.variances)
        return Rows(*(None if array is None else function(array) for array in arrays))

    def with_tracks_of_zeros(self, count):
        """Return the Rows with `count` more tracks in each column, all of whose measurements are zero."""
        N, m, _, M = self.z.shape
        z = np.concatenate([self.z, np.zeros((N, m, count, M))], axis=2)
        return Rows(z, self.seen, self.lengths, self.variances)


@dataclass(frozen=True)
class Epochs:
    """The measurements z (N, m, M) of M tracks, NaN where one is missing, and the conditions of their N epochs.

    lengths (N, M or 1) are those of the steps before each epoch, in units of the model's dt, or None where all are one.
    variances (N, m, M or 1) are those of the measurements, or None where they are the model's.
    """

    z: np.ndarray
    lengths: np.ndarray | None = None
    variances: np.ndarray | None = None

    @cached_property
    def missing(self):
        """The mask of the measurements that are missing, (N, m, M)."""
        return np.isnan(self.z)

    @property
    def complete(self):
        """Say whether nothing is missing: a NaN makes the sum NaN, sooner seen than a mask (so do two infinities)."""
        return not math.isnan(self.z.sum())

    @property
    def differ_in_gaps_only(self):
        """Say whether all steps are one dt and all variances the model's: then epochs without gaps are all alike."""
        return self.lengths is None and self.variances is None

    @cached_property
    def layout(self):
        """The Layout: one column for all tracks if they have the same gaps, steps and variances."""
        widths = [array.shape[-1] for array in (self.lengths, self.variances) if array is not None]
        alike = all(width == 1 for width in widths) and bool((self.missing == self.missing[..., :1]).all())
        return Layout(one_column=alike)

    def of(self, tracks):
        """Return the Epochs of some tracks, a slice or a mask of them."""
        lengths, variances = (
            array if array is None or array.shape[-1] == 1 else array[..., tracks]
            for array in (self.lengths, self.variances)
        )
        return Epochs(self.z[..., tracks], lengths, variances)

    def noise(self, R):
        """Return the covariances of the measurements (N, m, m, M or 1), or (m, m, 1) where all are the model's R."""
        if self.variances is None:
            return R[..., None]
        # The variances (N, m, 1, M or 1) times the identity (m, m, 1): each stands on the diagonal of its matrix.
        return known_variances(self.variances, R)[:, :, None] * np.eye(len(R))[..., None]


class Layout(NamedTuple):
    """The places of tracks in columns: all of them in one, with one covariance, or each in a column of its own."""

    one_column: bool

    def count_of_columns(self, tracks):
        """Return the number of columns of so many tracks."""
        return 1 if self.one_column else tracks

    def as_columns(self, array):
        """Return a view of an array (..., M) of all tracks: (..., M, 1) in one column, else (..., 1, M)."""
        return array[..., None] if self.one_column else array[..., None, :]

    def of_tracks(self, P, tracks):
        """Return a view of the covariances of some tracks, a slice, from those of all columns (..., 1 or M)."""
        return P if self.one_column else P[..., tracks]

    def rows(self, epochs):
        """Return the Rows of Epochs of these tracks, or of some of them."""
        seen = ~epochs.missing[..., :1] if self.one_column else ~epochs.missing
        z = self.as_columns(np.where(epochs.missing, 0, epochs.z))
        lengths = None if epochs.lengths is None else np.broadcast_to(epochs.lengths, (len(z), seen.shape[-1]))
        # The variance of a measurement that is missing may be invalid: it is not used, and must not spread.
        variances = None if epochs.variances is None else np.where(seen, epochs.variances, 1)
        return Rows(z, seen, lengths, variances)


def known_variances(variances, R):
    """Return variances (N, m, M), those of R (m, m) where there are none: a measurement that is missing needs none.

    >>> known_variances(np.array([[[2.0, np.nan]]]), R=np.eye(1))
    array([[[2., 1.]]])
    """
    known = np.isfinite(variances) & (variances > 0)
    return np.where(known, variances, np.diag(R)[:, None])
