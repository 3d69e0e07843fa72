"""Earth-centred coordinates on the WGS-84 ellipsoid."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array


def geodetic(pos_e_m: Array) -> tuple[float, float, float]:
    """Latitude and longitude (rad) and height (m) over the WGS-84 ellipsoid of an ECEF position (3,), m."""
    a, flattening = 6378137.0, 1 / 298.257223563
    e2 = flattening * (2 - flattening)
    x, y, z = (float(v) for v in pos_e_m)
    level = float(np.hypot(x, y))
    latitude = float(np.arctan2(z, level * (1 - e2)))
    for _ in range(6):  # each round gains two to three digits near the ground
        normal = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
        latitude = float(np.arctan2(z + e2 * normal * np.sin(latitude), level))
    normal = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    height = level * np.cos(latitude) + z * np.sin(latitude) - a * np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    return latitude, float(np.arctan2(y, x)), float(height)


def enu_from_ecef(latitude_rad: float, longitude_rad: float) -> Array:
    """Rotation (3, 3) that takes ECEF vectors to east, north, up at a place."""
    s_lat, c_lat = np.sin(latitude_rad), np.cos(latitude_rad)
    s_lon, c_lon = np.sin(longitude_rad), np.cos(longitude_rad)
    return np.array(
        [
            [-s_lon, c_lon, 0.0],
            [-s_lat * c_lon, -s_lat * s_lon, c_lat],
            [c_lat * c_lon, c_lat * s_lon, s_lat],
        ]
    )
