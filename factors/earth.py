"""The rotating Earth as the sensors feel it at the origin of n."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array

#: Earth rotation rate, rad/s (WGS-84).
EARTH_RATE_RAD_S = 7.292115e-5


def earth_rate_n(latitude_deg: float) -> Array:
    """Earth rotation in n (east, north, up), rad/s."""
    latitude = np.radians(latitude_deg)
    return EARTH_RATE_RAD_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])


def normal_gravity(latitude_deg: float, height_m: float = 0.0) -> float:
    """Normal gravity, m/s^2: Somigliana's closed form on the WGS-84 ellipsoid, second-order free-air change."""
    s2 = np.sin(np.radians(latitude_deg)) ** 2
    surface = 9.7803253359 * (1 + 0.00193185265241 * s2) / np.sqrt(1 - 0.00669437999014 * s2)
    a, flattening, m = 6378137.0, 1 / 298.257223563, 0.00344978650684
    height = height_m / a
    return float(surface * (1 - 2 * (1 + flattening + m - 2 * flattening * s2) * height + 3 * height**2))
