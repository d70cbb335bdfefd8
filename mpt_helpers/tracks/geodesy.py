"""Degrees in metres and back: a plane that touches the Earth, the ellipsoid of WGS 84, at an origin."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._checks import Array

SEMI_MAJOR = 6378137.0  # m
FLATTENING = 1 / 298.257223563
ECCENTRICITY2 = FLATTENING * (2 - FLATTENING)
# Rounds of two iterations that converge by a factor of 300 and of 20 or more each, some 1000 km from the origin.
ROUNDS_OF_LATITUDE, ROUNDS_OF_HEIGHT = 5, 12


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


def axes_at(lat: float, lon: float) -> Array:
    """Return the directions east, north and up at a place, as rows (3, 3)."""
    lat, lon = np.radians(lat), np.radians(lon)
    east = [-np.sin(lon), np.cos(lon), 0.0]
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
