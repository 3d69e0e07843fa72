"""What J. Zheng et al., Micromachines 12 (2021) 1527, state in numbers; their figures 7-16 are curves only."""

from __future__ import annotations

#: Table 3: SEP (m) in cutting cycles 1-4.
TRADITIONAL = (1.75, 1.99, 2.28, 2.31)
COMPENSATED = (0.21, 0.29, 0.33, 0.17)
PROPOSED = (0.50, 0.32, 0.13, 0.17)

#: Figure 12 and the text: scale factor, mounting about right and up (deg), with and without RTS.
CALIBRATION_RTS = (0.017, 0.333, -0.307)
CALIBRATION_FILTER = (0.029, 0.352, 0.093)

#: Figures 7-8: spacing of the closed-path points, m. Table 2: added error settings.
INTERVALS_M = (2, 6, 10)
PARS = tuple(range(1, 13))
#: Figure 11: span of the pure inertial solution, s.
PURE_INERTIAL_S = 300.0
