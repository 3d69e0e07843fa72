"""Simulated shifts with known truth: the reference scenarios.

``simulate("shearer-mems", seed=11)`` returns a `SensorLog` with its truth; the same seed and options give the
same log. Every error is zero-mean normal with exactly the sigma that the log declares, unless the scenario fixes its
value: shearer-lidar has the fixed errors of its paper, of the size of the declared sigmas, and face-end-uwb delays some
ranges. What a log does not tell of the supports beside the machine is in `graphnav.simulation.supports.supports_truth`,
what it does not tell of the ranges in `graphnav.simulation.uwb_truth.uwb_truth`.

A log of roadheader-stereo names its images; they are rendered where its folder is written, by the command line or by
`write_images`, or one by one by `render_pairs`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from graphnav.log import SensorLog
    from graphnav.simulation.stereo_images import render_pairs, write_images

__all__ = ["SCENARIOS", "render_pairs", "simulate", "write_images"]

#: Scenario name -> {"description": text, "options": {option: text}}, for help texts.
SCENARIOS: dict[str, dict[str, Any]] = {
    "shearer-mems": {
        "description": "MEMS IMU and odometer on a shearer, 44.6 m face, 4 cutting cycles, 17 minutes",
        "options": {
            "interval_m": "spacing of the closed-path points: 2 (default), 6 or 10",
            "par": "error setting 1-12 of the paper's Table 2 added on top; 0 (default) adds nothing",
            "sensors": "imu,odometer,closed-path (default); closed-path may be left out, uwb (at the near end) added",
        },
    },
    "full-shift": {
        "description": "tactical IMU and odometer on a shearer, 350 m face, up to 6 cutting cycles, 7.1 h",
        "options": {
            "hours": "length of the log, 0.02 to 7.1 (default)",
            "sensors": "imu,odometer,closed-path (default); closed-path may be left out, uwb (at the near end) added",
        },
    },
    "shearer-lidar": {
        "description": "tactical IMU, odometer and LiDAR beside the supports of a 350 m face, 6 cutting cycles, 7.1 h",
        "options": {
            "cycles": "number of cutting cycles, 1 to 6 (default)",
            "scans": "raw scans as well (default), in short stretches at the ends of the face and at the start",
            "draw": "draw mounting, initial attitude and LiDAR errors in place of the paper's fixed values",
        },
    },
    "face-end-uwb": {
        "description": "MEMS IMU and UWB ranges on a shearer that drives 7 m past four anchors at the face end",
        "options": {
            "site": "surface or underground (default), where dust and steel make the ranges worse",
            "nlos_share": "share of ranges with a delay that the log does not tell, 0 (default) to 1",
            "nlos_max_m": "the delay is uniform up to this, 3 (default)",
        },
    },
    "roadheader-stereo": {
        "description": "tactical IMU and stereo camera on a roadheader that drives 20 m up a dark, dusty roadway",
        "options": {
            "rate_hz": "frames per second, 1 to 30; 5 (default)",
            "images": "rendered image pairs (default), or none",
            "tracks": "tracks of features drawn without images; none (default)",
            "outlier_share": "share of wrong matches among the tracks, 0 (default) to less than 1",
        },
    },
}


def simulate(scenario: str, seed: int = 0, **options: Any) -> SensorLog:
    """Simulate a reference scenario.

    The images of roadheader-stereo are named in the log but not made. ``graphnav simulate roadheader-stereo -o L``
    writes both; ``gn.write(log, "L")`` writes the log alone, and then `write_images` its images:
    ``write_images("L", "roadheader-stereo", seed, ...)``.

    Parameters
    ----------
    scenario : a key of `SCENARIOS`.
    seed : of ``numpy.random.default_rng``; every error and the shape of the face follow from it.
    **options : see ``SCENARIOS[scenario]["options"]``.

    Raises
    ------
    ConfigError
        Unknown scenario or option, a value out of range, or a sensor that is not available yet.
    """
    from graphnav.errors import ConfigError
    from graphnav.simulation.face_end import simulate_face_end
    from graphnav.simulation.roadheader import simulate_roadheader
    from graphnav.simulation.roadheader_figures import RoadheaderSpec
    from graphnav.simulation.scenarios import resolve
    from graphnav.simulation.shearer import simulate_shearer
    from graphnav.simulation.uwb_figures import FaceEndSpec

    spec = resolve(scenario, options)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ConfigError(f"seed = {seed!r}, expected a whole number of zero or more")
    if isinstance(spec, FaceEndSpec):
        return simulate_face_end(scenario, spec, seed, options=options)
    if isinstance(spec, RoadheaderSpec):
        return simulate_roadheader(scenario, spec, seed, options=options)
    return simulate_shearer(scenario, spec, seed, options=options)


def __getattr__(name: str) -> Any:
    """Import what renders images on first use (PEP 562)."""
    if name not in ("render_pairs", "write_images"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from graphnav.simulation import stereo_images

    return getattr(stereo_images, name)
