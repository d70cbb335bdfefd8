"""Degrees to metres and back, on the ellipsoid of WGS 84.

`to_plane` and `from_plane` use the plane that is tangent to the Earth at an origin. A recorded track lies on a `Chart`,
which is large enough for a long flight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._checks import Array, refuse

SEMI_MAJOR = 6378137.0  # m
FLATTENING = 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
# Rounds of two iterations: each gains a factor of 300, or of 20, and more, up to some 1000 km from the origin.
ROUNDS_OF_LATITUDE, ROUNDS_OF_HEIGHT = 5, 12
# Segments within ONE_CHART (m) of their common middle share a chart, on which metres are true to 0.1 % there. The far
# side of the Earth cannot be charted: NEARLY_ALL fixes of a segment must lie within FARTHEST of its middle.
ONE_CHART, FARTHEST, NEARLY_ALL = 500e3, 15_000e3, 0.95


def earth_centred(lat: ArrayLike, lon: ArrayLike, height: ArrayLike) -> Array:
    """Return positions (3, N) in metres from the centre of the Earth, from degrees and heights above the ellipsoid."""
    lat, lon = np.radians(lat), np.radians(lon)
    radius = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
    flat = (radius + height) * np.cos(lat)
    return np.array([flat * np.cos(lon), flat * np.sin(lon), (radius * (1 - ECCENTRICITY2) + height) * np.sin(lat)])


def geodetic(position: Array) -> tuple[Array, Array, Array]:
    """Return latitudes and longitudes in degrees and heights in metres of positions (3, N) from the Earth's centre."""
    x, y, z = position
    flat = np.hypot(x, y)
    lat = np.arctan2(z, flat * (1 - ECCENTRICITY2))
    for _ in range(ROUNDS_OF_LATITUDE):
        radius = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + radius * ECCENTRICITY2 * np.sin(lat), flat)
    radius = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY2 * np.sin(lat) ** 2)
    # Along the normal, which loses no digits at the poles.
    height = flat * np.cos(lat) + z * np.sin(lat) - SEMI_MAJOR**2 / radius
    return np.degrees(lat), np.degrees(np.arctan2(y, x)), height


def axes_at(lat: ArrayLike, lon: ArrayLike) -> Array:
    """Return the directions east, north and up at one position (3, 3) or at several (3, 3, N)."""
    lat, lon = np.radians(lat), np.radians(lon)
    east = [-np.sin(lon), np.cos(lon), 0 * lon]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.array([east, north, up])


def to_plane(lat: Array, lon: Array, origin: tuple[float, float, float]) -> Array:
    """Return metres east and north (N, 2) of an origin, of positions at its height."""
    away = earth_centred(lat, lon, origin[2]) - earth_centred(*origin)[:, None]
    return (axes_at(*origin[:2])[:2] @ away).T + 0.0  # without -0.0


def from_plane(z: Array, origin: tuple[float, float, float]) -> tuple[Array, Array]:
    """Return latitudes and longitudes of positions (N, 2) east and north of an origin, at its height.

    The Earth falls away from the plane, by 1.8 km at 150 km: the iteration finds how far below it the positions lie.
    """
    up = np.zeros(len(z))
    start, axes = earth_centred(*origin)[:, None], axes_at(*origin[:2])
    for _ in range(ROUNDS_OF_HEIGHT):
        lat, lon, height = geodetic(start + axes.T @ np.vstack([z.T, up]))
        up -= height - origin[2]
    return lat, lon


@dataclass(frozen=True)
class Chart:
    """A map of the Earth around a middle, by latitude and longitude (°): the azimuthal equidistant projection.

    Metres are true at the middle, and everywhere along the direction towards it. Across that direction they are too
    long by a factor c / sin c at an angle c from the middle: by 0.1 % at 500 km, and by 9 % at the ends of a flight of
    9,000 km. So lengths and speeds of a track are measured on the Earth, not on its chart.
    """

    lat: float
    lon: float

    def metres(self, lat: Array, lon: Array) -> Array:
        """Return metres east and north of the middle (N, 2)."""
        east, north, up = axes_at(self.lat, self.lon) @ axes_at(lat, lon)[2]
        angle = np.arctan2(np.hypot(east, north), up)
        return np.column_stack([east, north]) / np.sinc(angle / np.pi)[:, None] * self._radii

    def degrees(self, z: Array) -> tuple[Array, Array]:
        """Return latitudes and longitudes of positions (N, 2): the inverse of `metres`."""
        east, north = (z / self._radii).T
        angle = np.hypot(east, north)
        across = np.sinc(angle / np.pi)
        x, y, z = axes_at(self.lat, self.lon).T @ np.array([across * east, across * north, np.cos(angle)])
        return np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x))

    @property
    def _radii(self):
        """The Earth's radii of curvature in the middle, towards the east and towards the north."""
        w = 1 - ECCENTRICITY2 * np.sin(np.radians(self.lat)) ** 2
        return SEMI_MAJOR / np.sqrt(w) * np.array([1.0, (1 - ECCENTRICITY2) / w])


def charts_of(lat: Array, lon: Array, segment: Array) -> tuple[list[Chart], Array, Array]:
    """Return the charts of a track, the number of the chart of each fix, and positions (N, 2) on it in metres.

    The middle of a chart is the fix nearest to the median, which no outlier moves. All segments share one chart if they
    are near each other.
    """
    where = earth_centred(lat, lon, 0.0)

    def middle_of(rows):
        own = where[:, rows]
        return rows[np.argmin(np.linalg.norm(own - np.median(own, axis=1)[:, None], axis=0))]

    numbers, chart = np.unique(segment, return_inverse=True)
    middles = [middle_of(np.flatnonzero(chart == k)) for k in range(len(numbers))]
    whole = middle_of(np.arange(len(lat)))
    if np.linalg.norm(where[:, middles] - where[:, [whole]], axis=0).max() < ONE_CHART:
        middles, chart = [whole], np.zeros(len(lat), dtype=np.intp)
    charts = [Chart(float(lat[middle]), float(lon[middle])) for middle in middles]
    z = np.empty((len(lat), 2))
    for k, each in enumerate(charts):
        own = chart == k
        z[own] = each.metres(lat[own], lon[own])
        away = np.quantile(np.linalg.norm(z[own], axis=1), NEARLY_ALL)
        if away > FARTHEST:
            need = f"segments that stay within {FARTHEST / 1000:,.0f} km of their middle"
            refuse("track", need, f"{away / 1000:,.0f} km")
    return charts, chart, z
