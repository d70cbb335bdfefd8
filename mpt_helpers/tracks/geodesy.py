"""Degrees in metres and back, on the ellipsoid of WGS 84.

A track lies in a `Plane` that touches the Earth at an origin. One that is too long for that, as of a flight, lies in a
`Belt` along a great circle, which bends with the Earth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._checks import Array

SEMI_MAJOR = 6378137.0  # m
FLATTENING = 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
# Rounds of two iterations that converge by a factor of 300 and of 20 or more each, some 1000 km from the origin.
ROUNDS_OF_LATITUDE, ROUNDS_OF_HEIGHT = 5, 12
# Further than this (m) from the origin of a plane lengths are over 0.3 % too short.
ONE_PLANE, ALL_BUT_FAULTS = 500e3, 0.95


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

    The Earth falls away from the plane, by 1.8 km at 150 km: how far below the plane the positions lie is searched.
    """
    up = np.zeros(len(z))
    start, axes = earth_centred(*origin)[:, None], axes_at(*origin[:2])
    for _ in range(ROUNDS_OF_HEIGHT):
        lat, lon, height = geodetic(start + axes.T @ np.vstack([z.T, up]))
        up -= height - origin[2]
    return lat, lon


@dataclass(frozen=True)
class Plane:
    """The plane that touches the Earth at an origin: latitude, longitude (°) and height (m)."""

    origin: tuple[float, float, float]

    def metres(self, lat: Array, lon: Array) -> Array:
        """Return metres east and north (N, 2); a fix beyond the horizon, a fault, is put as far away as it is."""
        z = to_plane(lat, lon, self.origin)
        chord = np.linalg.norm(earth_centred(lat, lon, self.origin[2]) - earth_centred(*self.origin)[:, None], axis=0)
        far = chord > 4 * ONE_PLANE
        z[far] *= (chord[far] / np.maximum(np.linalg.norm(z[far], axis=1), 1.0))[:, None]
        return z

    def degrees(self, z: Array) -> tuple[Array, Array]:
        """Return latitudes and longitudes of positions (N, 2)."""
        return from_plane(z, self.origin)

    def speed(self, z: Array, v: Array) -> Array:
        """Return the speed (N,) of velocities v (N, 2) at positions z."""
        return np.hypot(*v.T)


@dataclass(frozen=True, eq=False)
class Belt:
    """A Mercator's chart along the great circle that a long track follows: angles are true, and it ends nowhere.

    The rows of `axes` (3, 3) are directions in space: to the middle of the track, from there along the circle, and to
    the circle's pole. Metres are true along the circle, to the 0.5 % of the Earth's flattening, and c = 1 / cos of the
    angle from it too long beside it; `azimuth` is that of the circle, so that axes point east and north in the middle.
    """

    axes: Array
    azimuth: float

    @classmethod
    def along(cls, lat: Array, lon: Array, middle: int) -> Belt:
        """Return the Belt of positions (N,), of which one is their middle."""
        normals = axes_at(lat, lon)[2]
        pole = np.linalg.eigh(normals @ normals.T)[1][:, 0]
        start = normals[:, middle] - pole * (pole @ normals[:, middle])
        start /= np.linalg.norm(start)
        along = np.cross(pole, start)
        east, north, _ = axes_at(lat[middle], lon[middle])
        return cls(np.array([start, along, pole]), float(np.arctan2(along @ east, along @ north)))

    def metres(self, lat: Array, lon: Array) -> Array:
        """Return metres (N, 2), east and north in the middle; the way around the Earth goes on counting."""
        x, y, up = self.axes @ axes_at(lat, lon)[2]
        along = np.unwrap(np.arctan2(y, x))
        beside = np.arctanh(np.clip(up, -1 + 1e-12, 1 - 1e-12))
        return SEMI_MAJOR * np.column_stack([along, beside]) @ self._turn

    def degrees(self, z: Array) -> tuple[Array, Array]:
        """Return latitudes and longitudes of positions (N, 2)."""
        along, beside = (z @ self._turn.T).T / SEMI_MAJOR
        flat = 1 / np.cosh(beside)
        x, y, z = self.axes.T @ np.array([flat * np.cos(along), flat * np.sin(along), np.tanh(beside)])
        return np.degrees(np.arctan2(z, np.hypot(x, y))), np.degrees(np.arctan2(y, x))

    def speed(self, z: Array, v: Array) -> Array:
        """Return the speed (N,) of velocities v (N, 2) at positions z: the way that one second makes on the Earth."""
        here, there = (earth_centred(*self.degrees(each), 0.0) for each in (z, z + v))
        return np.linalg.norm(there - here, axis=0)

    @property
    def _turn(self):
        """The matrix from metres along and beside the circle to metres east and north."""
        sine, cosine = np.sin(self.azimuth), np.cos(self.azimuth)
        return np.array([[sine, cosine], [-cosine, sine]])


def charts_of(lat: Array, lon: Array, segment: Array) -> tuple[list[Plane | Belt], Array, Array]:
    """Return the charts of a track, in which of them each fix lies, and positions (N, 2) in metres.

    The middle of a chart is the fix nearest to the median, which no outlier moves. All segments share one if they are
    near each other.
    """
    where = earth_centred(lat, lon, 0.0)

    def middle_of(rows):
        own = where[:, rows]
        return int(rows[np.argmin(np.linalg.norm(own - np.median(own, axis=1)[:, None], axis=0))])

    numbers, chart = np.unique(segment, return_inverse=True)
    middles = [middle_of(np.flatnonzero(segment == number)) for number in numbers]
    whole = middle_of(np.arange(len(lat)))
    if np.linalg.norm(where[:, middles] - where[:, [whole]], axis=0).max() < ONE_PLANE:
        middles, chart = [whole], np.zeros(len(lat), dtype=np.intp)
    charts, z = [], np.empty((len(lat), 2))
    for k, middle in enumerate(middles):
        own = np.flatnonzero(chart == k)
        away = np.linalg.norm(where[:, own] - where[:, [middle]], axis=0)
        if np.quantile(away, ALL_BUT_FAULTS) < ONE_PLANE:
            charts.append(Plane((float(lat[middle]), float(lon[middle]), 0.0)))
        else:
            charts.append(Belt.along(lat[own], lon[own], int(np.flatnonzero(own == middle)[0])))
        z[own] = charts[-1].metres(lat[own], lon[own])
    return charts, chart, z
