"""Recorded UWB ranges: STAR-loc (IMU and ranges, carried by hand) and Plaza1 (odometry and ranges, a mower).

``python -m benchmarks.real starloc plaza1``: the data sets by name, both by default. Errors are those of the position
at the keyframes against the reference, nothing aligned; the smoother never sees the reference. STAR-loc needs its
recordings (GRAPHNAV_DATA or ../shared/data): a row without its recording has no value, and its target is not met.
Plaza1 comes with gtsam. Takes about two minutes.
"""

from __future__ import annotations

from benchmarks import _plaza, _starloc
from benchmarks._report import Before, parser, publish

SETS = {"starloc": _starloc.rows, "plaza1": _plaza.rows}


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
