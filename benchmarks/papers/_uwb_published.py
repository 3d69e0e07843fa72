"""What Cao et al. (2023) report: errors across the face (x) and up (z), m."""

from __future__ import annotations

#: Table 4, at the surface: largest, mean and standard deviation of the absolute error, x and z.
SURFACE = {
    "uwb": ((0.215, 0.062, 0.045), (0.311, 0.089, 0.066)),
    "uwb-vbukf": ((0.162, 0.049, 0.036), (0.236, 0.067, 0.046)),
    "imu-uwb": ((0.143, 0.036, 0.025), (0.269, 0.057, 0.041)),
    "imu-uwb-vbukf": ((0.076, 0.022, 0.016), (0.114, 0.038, 0.024)),
}
#: Section 3.2, underground: mean errors alone; of UWB with VB-UKF none is printed.
UNDERGROUND_MEAN = {"uwb": (0.128, 0.239), "imu-uwb": (0.102, 0.194), "imu-uwb-vbukf": (0.082, 0.158)}
ATTITUDE_DEG = 2.0


def mean(site: str, method: str) -> tuple[float, float] | None:
    """Mean errors x and z of a method at a site."""
    if site == "underground":
        return UNDERGROUND_MEAN.get(method)
    found = SURFACE.get(method)
    return None if found is None else (found[0][1], found[1][1])
