"""What is returned for a recorded track: the cleaned track, its prediction band and the file that it comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import bands
from .._checks import Array
from ..kalman import KalmanFilter
from . import geodesy, plot, report, writers
from .files import write_together
from .noise_fit import Line
from .readers import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Band:
    """The prediction band, and how well it holds on the half of a track that q and r were not fitted to.

    Attributes
    ----------
    seconds : float
        The horizon.
    half_width : float
        The median half-width in m of the band, which follows the errors checked so far.
    asked, held, own : float
        The nominal coverage of the band, its actual coverage, and that of the filter's own band.
    checked, independent : int
        The number of predictions that were checked, and of those that do not overlap in time.
    ahead : ForecastErrors
        The K forecast errors of the whole track.
    widths : ndarray (K, m)
        The half-width of the band at each of them.
    unseen : ndarray of bool (K,)
        Whether each lies in the second half.

    """

    seconds: float
    half_width: float
    asked: float
    held: float
    own: float
    checked: int
    independent: int
    ahead: bands.ForecastErrors = field(repr=False)
    widths: Array = field(repr=False)
    unseen: NDArray[np.bool_] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Source:
    """The file that a track comes from.

    rows (N,): the row of each fix in the recording; left_out: the number of rows left out, by reason
    charts: the charts of the track (`geodesy`); plane (N,): the chart of each fix; none, and zeros, for metres
    said: notes on how the file was read
    """

    path: Path | str
    recording: Recording
    rows: NDArray[np.intp]
    left_out: dict[str, int]
    charts: list[geodesy.Chart]
    plane: NDArray[np.intp]
    said: list[str]


@dataclass(frozen=True, eq=False, repr=False)
class Cleaned:
    """A recorded track without its faults; printed, it is its report.

    `==` tests identity; to compare two results, compare their arrays.

    Attributes
    ----------
    t : ndarray (N,)
        Times in s.
    z : ndarray (N, m)
        Positions in m as recorded, NaN where there is none.
    segments : ndarray of int (N,)
        The segment of each fix, 0, 1, ..., and -1 where it is refused or there is none.
    x, P : ndarray (N, 2 m), (N, 2 m, 2 m)
        Smoothed position and velocity of each axis, [east, v_east, north, v_north], and their covariance; NaN where a
        row lies in no segment.
    q, r : float
        Process noise (m²/s³) and measurement variance of a fix (m²), the same for all axes.
    log_errors : dict
        Standard errors of their logarithms. That of r is infinite where r is not an estimate but the rounding of the
        numbers, or assumed: on a sparse track, or a circling one, the motion hides the noise of the fixes.
    rounding : bool
        Whether r is the rounding of the numbers: the recorder has smoothed the positions, which hides their noise.
    band : Band or None
        None for a track too short to judge one on.
    filter : KalmanFilter
        The filter of all segments in sequence, for the measurements `line.z`.
    line : Line
        The rows of all segments in sequence, an hour or more apart.
    recordings : list
        The rows where a recording begins: at the start, after each pause, and at each new segment of the file.
    repeats : ndarray of bool (N,)
        The rows that are not fixes of their own: repeated positions, and all but the newest of several at one time.
    said : list
        Notes on the times and on repeated rows.
    source : Source or None
        The file that the track comes from.

    """

    t: Array
    z: Array
    segments: NDArray[np.intp]
    x: Array
    P: Array
    q: float
    r: float
    log_errors: dict[str, float]
    rounding: bool
    band: Band | None
    filter: KalmanFilter
    line: Line
    recordings: list[int]
    repeats: NDArray[np.bool_]
    said: list[str]
    source: Source | None = None

    def __repr__(self) -> str:
        return self.report()

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Whether each row is a fix that is kept, (N,)."""
        return self.segments >= 0

    @property
    def refused(self) -> NDArray[np.intp]:
        """The rows of the refused fixes."""
        return np.flatnonzero(~self.mask & np.isfinite(self.z).any(axis=1) & ~self.repeats)

    @property
    def stretches(self) -> int:
        """The number of segments."""
        return int(self.segments.max()) + 1

    @property
    def unusual(self) -> list[str]:
        """Questions that the track raises: it may be in other units, or have too few digits."""
        return report.unusual(self)

    def report(self) -> str:
        """Return what was done to the track, and what was found, in words.

        Returns
        -------
        str
            Several lines of text.

        """
        return report.text(self)

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the report.

        Returns
        -------
        dict
            The numbers by name, ready for JSON.

        """
        return report.summary(self)

    def plot(self) -> Figure:
        """Draw the track: a map with the refused fixes, and the speed with its band.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        """
        return plot.figure(self)

    def gpx(self, path: str | PathLike[str], overwrite: bool = False) -> None:
        """Write the smoothed track as a GPX file.

        Times, heights, segments and everything else in the source file are kept. A refused fix within a segment is
        moved to the smoothed line, and one between segments is left out. After a jump a new segment begins, so that
        maps draw no line across it.

        Parameters
        ----------
        path : path
            The file to write; it must not be the source.
        overwrite : bool
            Whether an existing file is replaced.

        Raises
        ------
        ValueError
            For a track in metres.
        FileExistsError
            If the file exists and `overwrite` is False.

        """
        write_together({Path(path): writers.gpx_bytes(self)}, overwrite, self.source.path)

    def to_frame(self) -> Any:
        """Return the track as a pandas frame, with one row for each fix that was used.

        Returns
        -------
        pandas.DataFrame
            `time`, the smoothed `lat`, `lon` (of a track in degrees), `x`, `y` (m) and velocities `v_x`, `v_y` (m/s)
            (`x0`, `x1`, ... of more than three axes),
            `sigma` and `sigma_v`, the standard deviations of these (the largest of the axes), `kept`, and the number of
            the segment; NaN and -1 outside of segments. Of a track in degrees the velocities are those east and north
            on the Earth, while `x`, `y` lie on a chart of the segment, which is true near its middle only. The rows
            have the labels of the frame that the track is from.

        """
        return writers.frame_of(self)

    @property
    def starts(self) -> NDArray[np.intp]:
        """The first rows of the segments that begin after a jump rather than a pause."""
        kept = np.flatnonzero(self.mask)
        firsts = kept[np.unique(self.segments[kept], return_index=True)[1]]
        recording = np.searchsorted(self.recordings, firsts, side="right")
        return firsts[1:][np.diff(recording) == 0]
