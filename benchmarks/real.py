"""Recorded data with ranges or cameras.

STAR-loc (IMU, ranges, AprilTags; carried by hand), Plaza1 (odometry and ranges, a mower), an excerpt of KITTI with
images and a KITTI drive's features, AER1513 dataset 3 (rates and tracked points).

``python -m benchmarks.real starloc plaza1``: the data sets by name, all by default. Errors are those of the position
at the keyframes against the reference, nothing aligned; the smoother never sees the reference. Recordings are looked
for in GRAPHNAV_DATA or ../shared/data: a row without its recording has no value, and its target is not met. Plaza1 and
the KITTI features come with gtsam. Takes about eight minutes.
"""

from __future__ import annotations

from benchmarks import _dataset3, _drifts, _plaza, _starloc
from benchmarks._report import Before, parser, publish

SETS = {
    "starloc": _starloc.rows,
    "plaza1": _plaza.rows,
    "kitti_stereo": _drifts.stereo_rows,
    "kitti_tracks": _drifts.tracks_rows,
    "aer1513": _dataset3.rows,
}


def main() -> None:
    """Measure and print."""
    arguments = parser(__doc__)
    arguments.add_argument("sets", nargs="*", metavar="SET", help=f"any of {', '.join(SETS)} (default: all)")
    options = arguments.parse_args()
    unknown = sorted(set(options.sets) - set(SETS))
    if unknown:
        arguments.error(f"no data set {unknown[0]}: choose from {', '.join(SETS)}")
    before = Before.now()
    publish([row for name in options.sets or SETS for row in SETS[name]()], options.json, before)


if __name__ == "__main__":
    main()
