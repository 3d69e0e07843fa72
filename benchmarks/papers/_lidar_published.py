"""What the INS/LiDAR paper (J. Zheng et al., 2021) states in numbers; its figures 7, 8 and 10 are curves only."""

from __future__ import annotations

#: Table 3: maximum position error (m) east, north, up in cutting cycles 1-6.
TRADITIONAL = (
    (-0.210, 0.087, 0.005), (-0.212, 0.073, 0.001), (-0.500, 0.107, -0.115),
    (-0.499, 0.106, -0.121), (-0.632, 0.177, -0.328), (-0.636, 0.188, -0.336),
)  # fmt: skip
IMPROVED = (
    (-0.210, 0.080, 0.005), (-0.212, 0.081, 0.001), (-0.332, 0.107, -0.103),
    (-0.330, 0.097, -0.110), (-0.453, 0.181, -0.260), (-0.457, 0.178, -0.268),
)  # fmt: skip
PROPOSED = (
    (-0.081, 0.125, 0.075), (-0.028, 0.166, 0.082), (-0.188, 0.188, 0.074),
    (-0.111, 0.149, 0.071), (0.128, 0.163, 0.054), (0.108, 0.133, 0.047),
)  # fmt: skip
#: Table 4: creep (m) between successive cycles, calculated and standard.
CREEP = (-0.172, -0.223, -0.174, -0.224, -0.176)
CREEP_STANDARD = (-0.176, -0.225, -0.175, -0.225, -0.175)

#: Section 5.1: initial attitude and scanner mounting (minutes of arc, right, forward, up), in the paper's signs.
SELECTION_ATTITUDE = (-0.23, 0.24, -15.60)
SELECTION_MOUNTING = (-0.60, 0.0, 13.80)
#: Figure 7: (number of legs, mode, distance in m).
MODES = tuple((3, mode, 0.0) for mode in range(1, 10))
NUMBERS = tuple((count, 2, 0.0) for count in range(1, 5))
DISTANCES = tuple((1, 2, distance) for distance in (0.0, 1.5, 3.0, 4.5, 6.0, 7.5))
#: Figure 8, and section 5.3.
CORRECTED = (1, 2, 7.5)
COMPARED = (1, 2, 9.0)


def largest(rows: tuple[tuple[float, float, float], ...]) -> tuple[float, ...]:
    """Largest error of any cycle by axis, m."""
    return tuple(max(abs(row[axis]) for row in rows) for axis in range(3))
