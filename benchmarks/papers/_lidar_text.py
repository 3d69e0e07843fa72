"""The words of the INS/LiDAR page; where they hold figures, these come from the outcomes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks._report import Before
from benchmarks.papers import _lidar_published as published
from benchmarks.papers._lidar_cases import (
    AS_PUBLISHED,
    CORRECTED,
    FILTER,
    GRAPH,
    IMPROVED,
    IMPROVED_TOLD,
    TRADITIONAL,
    UNCORRECTED,
    Found,
    label,
)
from benchmarks.papers._lidar_rows import Results, at_end_2, budget, largest, middle

LENGTH_M = 350.0
_NEAR_ZERO_M = 0.05
_SETTLED_S = 1800.0
TITLE = "# Reproduction: INS and LiDAR beside the legs of the roof supports"
CAPTIONS = {
    "figure-7": "Errors over three cuts by mode, by number of legs and by least distance; cuts grey",
    "figure-8": "Errors with and without the posterior correction, and with the filter's own choice; cuts grey",
    "figure-10": "Errors of all methods in the paper's world and in the scenario, below each without dead reckoning",
}


def source(results: Results, before: Before) -> str:
    """What this is, of what, and how it was made."""
    failed = f"\n\nRuns that failed: {'; '.join(results.failed)}." if results.failed else ""
    sources = ", ".join(sorted({part for one in results.found for part in one.sources.split("+")}))
    seeds = max(len(results.of_world(world)) for world in ("paper", "scenario"))
    return f"""
J. Zheng et al., "A LiDAR-Aided Inertial Positioning Approach for a Longwall Shearer in Underground Coal Mining" (2021):
figures 7, 8 and 10, tables 3 and 4. The paper is a simulation, and so is this: a shearer on 350 m of track, six cycles,
7.1 h. The page is made of the kept outcomes of

```
python -m benchmarks.papers.lidar_ins --seeds {seeds} --kept KEPT --page docs/papers/lidar-ins.md
```

(sources of graphnav {sources}; {before.machine["processor"]}); do not edit it. To measure the graph alone again, remove
`KEPT/*-graph.json` and run this once more.{failed}
"""


WORLDS = """
- *Filter* is the paper's: 15 states and three for the place of each of N legs, equations 10 to 24, no odometer
  (`graphnav smooth --method lidar-ekf`, section `lidar_filter` of the configuration). Left to itself it makes the
  paper's automatic choice (N = 1, d as large as legs rest, mode 2 or 7) and its posterior correction (PICM).
- *Graph* is `graphnav.smooth(log)`, batch: legs, odometer and closed path, scanner calibration estimated. Where legs
  are points, in all but the scenario, it is told so (`lidar.lean_sigma_deg = 0.01`): how far a leg leans does not show
  from a smooth track, and left open it keeps the solver creeping along a valley, unconverged after 120 iterations.
- *The paper's world*: the errors that the paper states, a smooth track, upright legs. What it does not state is taken
  from its own dead reckoning: an up gyro bias of 0.035 deg/h (fitted to the east column of traditional dead reckoning)
  and an odometer scale of 2.5e-4 (from north after cycle 1). These two columns are fitted; everything else is found.
  The other gyro and accelerometer biases are those under which the stated alignment errors stay as they are.
- *The scenario* is `shearer-lidar`: a machine that wobbles, leaning legs, drawn biases, odometer scale and slip.
- In figures 7 and 8 the errors are those of section 5.1 and the track is straight, without creep.
- Figure 5, which shows where zones A and B lie, is not in words in the paper. B is taken as behind the machine in the
  forward cut: only then can a leg of mode 2 "have moved in the current cycle", and only then does the error budget give
  the paper's north error.
- No estimator is given the truth. NEES is the mean of e' P^-1 e / 3 for position: below 1 the covariance is too wide.
"""


TABLE_3 = """
## Table 3 and figure 10: largest error of any cycle
"""


def why_table_3(results: Results) -> str:
    """Where and why table 3 differs."""
    found = results.of_world("paper")
    own = {name: middle(found, name) for name in (TRADITIONAL, IMPROVED, IMPROVED_TOLD, AS_PUBLISHED)}
    parts = []
    reckoned, closed, told, filtered = own.values()
    if reckoned is not None and closed is not None and told is not None:
        stops = np.median([at_end_2(one.courses[TRADITIONAL]) for one in found], axis=0)
        parts.append(f"""
- Traditional dead reckoning is at {_ratios(reckoned, published.TRADITIONAL)} times the paper's figures. The height is
  the one column that is not fitted: the heading's drift turns the Earth's rate into pitch. Ours is largest at end 1 of
  the last cycle; the paper says that its largest errors are at end 2, and there ours is {stops[2]:.3f} m
  ({stops[2] / published.largest(published.TRADITIONAL)[2]:.2f} times the paper's).
- With closed path it is at {_ratios(closed, published.IMPROVED)} times. North does not fit because of creep: a closed
  path places the new line by the push, and the creep of nearly 1 m in all, of which it is not told, stays in the
  position. Told of the mean creep (0.195 m a cycle) it has {told[1]:.3f} m
  ({told[1] / published.largest(published.IMPROVED)[1]:.2f} times): the paper's must have known the creep.""")
    if filtered is not None:
        parts.append(_why_filter(results, filtered))
    if any(GRAPH in one.courses for one in found):
        parts.append(_beside(results, "paper"))
    elif any(text.startswith("paper") and GRAPH in text for text in results.failed):
        parts.append("""
- The graph has no row in the paper's world: runs that failed, above.""")
    return "\n".join(part.strip("\n") for part in parts)


def _why_filter(results: Results, filtered: np.ndarray) -> str:
    """North and height, and why east is what it is."""
    found, quiet = results.of_world("paper"), results.of_world("quiet")
    each = [largest(one.courses[AS_PUBLISHED])[0] for one in found]
    north_each = [largest(one.courses[AS_PUBLISHED])[1] for one in found]
    first = [one.courses[AS_PUBLISHED].stop_m[0, 0] for one in found]
    known = budget(published.COMPARED, LENGTH_M)
    assert known is not None
    east, north = float(known[0]), float(known[1])
    expected, drift = east + LENGTH_M * np.radians(4.6 / 60), LENGTH_M * np.radians(0.035 * 0.5)
    lines = f"""
- The filter with the paper's settings is at {_ratios(filtered, published.PROPOSED)} times the paper's figures. Height
  is the pitch of mounting and attitude, the same for every seed. North is the scanner's systematic errors, and a walk
  of some centimetres that differs by seed ({_listed(north_each)} m): equations 25-27 give {north:+.3f} m at the first
  arrival, the paper has +0.125 m.
- East is {_listed(each)} m by seed, the paper's 0.188 m: every draw is above it. Of the first arrival
  ({_listed(first)} m, the paper's -0.081 m) the budget explains {expected:+.3f} m ({east:+.3f} m of the scanner, and
  4.6' left between mounting and heading), the up drift of the paper's own dead reckoning {-drift:+.3f} m. The rest is
  the heading: 1' is 0.1 m after 350 m, legs that are left behind tell no direction, and the gyro's stated white noise
  (0.01 deg/sqrt(h)) lets the Earth's rate tell it no better than 3' in an hour."""
    if quiet:
        still = [largest(one.courses[AS_PUBLISHED])[0] for one in quiet]
        ratio = np.median(still) / published.largest(published.PROPOSED)[0]
        lines += f"""
- That it is this noise shows when it alone is left out: then east is {_listed(still)} m by seed, {ratio:.2f} times the
  paper's in the median, and after the first half hour the heading moves within {_moves(quiet)}', otherwise within
  {_moves(found)}' (median of the seeds). The filter's own
  covariances cover the errors (NEES below 1). How the paper's filter held its
  heading within 1' of what alignment left, it does not say; its P0, Q and R are not stated."""
    return lines


def _moves(found: Sequence[Found]) -> str:
    """How far the heading's error moves after the first half hour, minutes of arc, median."""
    courses = [one.courses[AS_PUBLISHED] for one in found]
    return f"{np.median([np.ptp(course.heading_min[course.t_s > _SETTLED_S]) for course in courses]):.1f}"


SCENARIO = """
## The same in the scenario

The paper's figures are of a plainer world and stand in the table for orientation. The scenario's own target is for the
graph: 0.10 / 0.10 / 0.05 m.
"""


def why_scenario(results: Results) -> str:
    """Reads the table."""
    found = results.of_world("scenario")
    own, reckoned = middle(found, FILTER), middle(found, TRADITIONAL)
    if own is None or reckoned is None:
        return ""
    lines = f"""
- The odometer of the scenario has a scale error of 0.002 (1 sigma: 0.7 m over the face) and noise of 0.5 m over the
  shift; that is the north error of dead reckoning, {reckoned[1]:.2f} m. The filter uses no odometer and has
  {own[1]:.2f} m.
- The filter's heading leaves the declared error of 20.9' within half a minute: the machine stands askew, so an error
  about its own up axis is a tilt as well, and that the accelerometers show, down to their drawn bias. The mounting
  error of 25.5', which the old heading balanced but for 4.6', then is a way turned by up to 30', 3 m after 350 m. The
  correction of the filter's own choice is found with the new heading and repairs the first arrival; later ones wander
  as the heading does.
- The scenario surveys end 2 once. To the filter that point tells the direction of the face alone (equation 30), to the
  graph also the place."""
    return lines + ("\n" + _beside(results, "scenario") if any(GRAPH in one.courses for one in found) else "")


def _beside(results: Results, world: str) -> str:
    """The graph beside the filter."""
    with_graph = [one for one in results.of_world(world) if GRAPH in one.courses]
    graph, own = middle(with_graph, GRAPH), middle(with_graph, FILTER)
    assert graph is not None and own is not None
    return f"""- The graph has {_listed(graph)} m where the filter with its own choice has {_listed(own)} m (median of
  {len(with_graph)} seeds that have both)."""


TABLE_4 = """
## Table 4: creep of the face

The paper registers scans of the roadway at successive arrivals at end 1 (equations 8 and 9). Here creep is the
difference of the positions estimated there, and by registration where `graphnav.creep` and scans are there.
"""


def why_table_4(results: Results) -> str:
    """Positions do not give creep."""
    errors = [np.abs(one.courses[FILTER].creep_m - one.creep_m).max() for one in results.of_world("paper")]
    if not errors:
        return ""
    seen = [np.abs(one.icp_m - one.creep_m).max() for one in results.found if one.icp_m is not None]
    ours = f" Ours, seen from the graph's positions, is off by up to {1000 * max(seen):.1f} mm." if seen else ""
    return f"""
Differences of the filter's positions miss the creep by up to {max(errors):.3f} m: a position at end 1 carries the whole
way there and back. The paper's 4 mm come from the registration, not from its filter.{ours}
"""


FIGURE_7 = """
## Figure 7: which legs

N = 3, d = 0 for the modes; mode 2, d = 0 for N; mode 2, N = 1 for d. The paper shows curves. One seed. Budget is what
equations 25-27 give for the scanner's systematic errors alone after 350 m (`graphnav.baselines.leg_budget`).
"""


def why_figure_7(results: Results) -> str:
    """What agrees and what does not."""
    modes, numbers, distances = (results.first(world) for world in ("modes", "numbers", "distances"))
    assert modes is not None and numbers is not None and distances is not None
    back = {mode: abs(modes.courses[label((3, mode, 0.0))].stop_m[1, 1]) for mode in range(1, 10)}
    undone = [mode for mode, value in back.items() if value < _NEAR_ZERO_M]
    others = [value for mode, value in back.items() if mode not in undone]
    by_number = [numbers.courses[label(s)].stop_m[0, 1] for s in published.NUMBERS]
    by_distance = [distances.courses[label(s)].stop_m[0, 1] for s in published.DISTANCES]
    east = [distances.courses[label(s)].stop_m[0, 0] for s in published.DISTANCES]
    gaps = [
        abs(one.courses[label(selection)].stop_m[0, 1] - expected[1])
        for one, chosen in ((modes, published.MODES), (numbers, published.NUMBERS), (distances, published.DISTANCES))
        for selection in chosen
        if (expected := budget(selection, LENGTH_M)) is not None
    ]
    ups = [course.stop_m[0, 2] for one in (modes, numbers, distances) for course in one.courses.values()]
    return f"""
- Modes {", ".join(map(str, undone))} undo on the way back what they did on the way out: north at end 1 is off by less
  than {_NEAR_ZERO_M:g} m, with the other modes by {min(others):.2f} to {max(others):.2f} m. The paper says so of modes
  2 and 7 alone. What undoes an error is that the same legs are used in both directions, so that each systematic error
  enters twice with opposite signs; with mode 6, the nearest legs of both zones, they are the same too.
- More legs and a larger distance both make north better: {_listed(by_number)} m at the first arrival for N = 1 to 4,
  {_listed(by_distance)} m for d = 0 to 7.5 m. As in the paper distance does more.
- East first grows with d and then falls: {_listed(east)} m, as the paper says.
- North at the first arrival is within {max(gaps):.2f} m of the budget (zones A or B; {np.median(gaps):.2f} m in the
  median).
- Height does not depend on the selection ({min(ups):.3f} to {max(ups):.3f} m at the first arrival); it is the pitch of
  mounting and attitude, a zigzag with the mileage.
- The heading's course does not depend on it much either, as in the paper.
"""


FIGURE_8 = """
## Figure 8: posterior correction of the mounting

The lateral place of the first arrival at end 2 turns the mounting by p_x / S_max (equations 30 to 32), and the log is
filtered again. Mode 2, N = 1, d = 7.5 m; below it what the filter chooses by itself, and the graph where it converges.
"""


def why_figure_8(results: Results) -> str:
    """What the correction does."""
    one = results.first("correction")
    assert one is not None
    before, after = (one.courses[name].stop_m for name in (UNCORRECTED, CORRECTED))
    told = one.courses[FILTER].told
    graph = "" if GRAPH in one.courses else "\n- The graph has no row here: it did not converge, or was not run."
    return f"""
- The correction takes east at the first arrival from {before[0, 0]:+.3f} to {after[0, 0]:+.3f} m and leaves north
  ({before[0, 1]:+.3f} and {after[0, 1]:+.3f} m) and height as they are, as in the paper. It cannot do more than that:
  where the heading moves later, east at end 2 is off again ({after[2, 0]:+.3f} m in the third cut).
- By itself the filter takes mode {told["mode"]:.0f} and d = {told["distance_m"]:g} m: with mode 2 it arrives at
  {told["arrival_forward_m_mode_2"]:.2f} m, with mode 7 at {told["arrival_forward_m_mode_7"]:.2f} m, of 350 m.{graph}
"""


def _ratios(own: np.ndarray, theirs: tuple[tuple[float, float, float], ...]) -> str:
    """East, north, height by the paper's largest."""
    return " / ".join(f"{a / b:.2f}" for a, b in zip(own, published.largest(theirs), strict=True))


def _listed(values: Sequence[float] | np.ndarray) -> str:
    """Values with a slash between."""
    return " / ".join(f"{value:.2f}" if abs(value) >= 0.995 else f"{value:.3f}" for value in values)
