"""What the paper on a roadheader's visual-inertial odometry reports: its table 6 and section 4.1.3."""

from __future__ import annotations

#: Order of all figures: x right of the roadway, y along it, z up, in m; then roll, yaw, pitch in deg.
AXES = ("x", "y", "z", "roll", "yaw", "pitch")
UNITS = ("m", "m", "m", "deg", "deg", "deg")
Six = tuple[float, float, float, float, float, float]

#: Table 6: largest error, signed mean and standard deviation of the paper's filter and of its SINS alone.
LARGEST: dict[str, Six] = {
    "vio-kf": (0.0360, 0.1172, 0.0150, 0.1129, 1.0616, 0.9759),
    "sins": (0.1148, 0.3942, 0.0581, 0.2203, 1.3589, 1.0110),
}
MEAN: dict[str, Six] = {
    "vio-kf": (-0.0012, -0.0615, 0.0073, -0.0343, -0.477, -0.5367),
    "sins": (-0.0036, -0.2061, 0.0314, -0.0631, -0.1227, -0.5782),
}
DEVIATION: dict[str, Six] = {
    "vio-kf": (0.0150, 0.0328, 0.0035, 0.0358, 0.2751, 0.2413),
    "sins": (0.0492, 0.1143, 0.0133, 0.0928, 0.6188, 0.2401),
}
#: Matched features that RANSAC keeps, about: of raw and of enhanced images.
MATCHED_RAW, MATCHED_ENHANCED = 150.0, 180.0
FRAMES_PER_SECOND = 30.0
#: Asked of the graph by the scenario: half of the paper's largest errors, or this many times the bound's sigma.
ASKED: Six = (0.018, 0.058, 0.0075, 0.056, 0.53, 0.49)
BOUNDS = 1.3
