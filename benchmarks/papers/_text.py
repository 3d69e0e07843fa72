"""The words of the page; where they hold figures, these come from the results."""

from __future__ import annotations

import math

from benchmarks._report import Before
from benchmarks.papers._cases import FOLLOWED, GRAPH, HALF_SECOND, SMALL
from benchmarks.papers._results import Results
from benchmarks.papers._rows import BASE

TITLE = "# Reproduction: MEMS sensors, odometer, closed path and RTS smoother"
CAPTIONS = {
    "comparison": "Position errors over time of the methods of table 3, one seed; cutting cycles grey",
    "intervals-matched": "Position errors over time by spacing of the closed-path points, matched preset, one seed",
    "intervals-paper": "The same with the paper's preset",
    "calibration": "Estimates of biases, scale and mounting angles over time, matched preset, one seed",
    "uncorrected": "Pure inertial navigation and dead reckoning by whose calibration they are told, one seed",
    "error-settings": "Rms 3-D error by added error setting",
}


def source(results: Results, before: Before) -> str:
    """What this is, of what, and how it was made."""
    pars = results.seeds("par 1")
    failed = f" {len(results.failed)} runs failed: {'; '.join(results.failed)}." if results.failed else ""
    return f"""
J. Zheng et al., "Research on the Shearer Positioning Method Based on the MEMS Inertial Sensors/Odometer Integrated
Navigation System and RTS Smoother", Micromachines 12 (2021) 1527: figures 7 to 16 and table 3. The paper drove a
wheeled carrier with an MTi-G-700 four times along 44.6 m, once, and judged it by centimetre GPS. Here the same path
is simulated (scenario `shearer-mems`): sensors drawn from the sigmas of the paper's table 1, {results.seeds(BASE)}
seeds, {pars} of them for the error settings. Every figure below was measured in one run of

```
python -m benchmarks.papers.mems_odometer --seeds {results.seeds(BASE)} --page docs/papers/mems-odometer.md
```

(sources {before.sources}; {before.machine["processor"]}).{failed} The page is written by that run; do not edit it.

- *Filter* is the paper's 19-state error-state Kalman filter; *RTS* is its smoother as the paper runs it, at each
  end of the face over the cycle just cut, the optimal points of the next cycle updated at once.
- *Paper preset*: appendix A (P0 x 3, Q x 5), all three rows of equation 19 at every odometer sample, equation 21
  with the declared push error alone. *Matched preset*: the sigmas that the log declares, the constraint across the
  machine once a second (the machine's wobble is no fresh error every 0.1 s), and at a closed-path point the first
  pass's own covariance.
- *Graph* is `graphnav.smooth(log)`, batch, with the closed path as a relative factor between two estimated passes.
- No estimator is given the truth. Estimates of biases and mounting angles are judged by what the simulator drew.
- Rms errors are over all seeds and keyframes, so one run gone astray shows. SEP is the median 3-D error in a cycle,
  and of that the median over the seeds. NEES is the mean of e' P^-1 e / 3 for position: 1 is consistent, above 1
  too sure.
"""


TABLE_3 = """
## Table 3 and figure 16: SEP per cutting cycle

The paper's "traditional method" is dead reckoning with the closed path of its reference 1; both are shown.
"""


def why_table_3(results: Results) -> str:
    """Where and why table 3 differs."""
    none, rest = results.sep_m(BASE, "dead-reckoning none"), results.sep_m(BASE, "dead-reckoning rest")
    paper, matched = results.sep_m(BASE, "rts-online paper"), results.sep_m(BASE, "rts-online matched")
    graph = results.sep_m(BASE, GRAPH)
    gain = 1 - sum(graph) / sum(matched)
    return f"""
- Without any compensation our dead reckoning is {min(none):.0f} to {max(none):.0f} m off where the paper's is about
  2 m: a bias of 720 deg/h is really drawn here, and turns the heading by 0.2 deg every second. With the bias of the
  first rest taken out, as any operator would, it is {min(rest):.1f} to {max(rest):.1f} m off, of the paper's
  order, from a scale error of 5 % and mounting angles of 3 deg.
- The paper's filter and RTS is worst in A1 (0.50 m) and best in A3. Ours with the paper's preset is at
  {listed(paper)} m. The far end is surveyed once in this scenario (2 cm), at the end of A1, and the smoother
  carries that back over A1; the paper has no such point. What later cycles lack against the paper's 0.13 and 0.17 m
  is explained with the preset below.
- With matched sigmas the same filter and smoother reach {listed(matched)} m, the graph {listed(graph)} m:
  {100 * gain:.0f} % less over the four cycles.
"""


INTERVALS = """
## Figures 7 and 8: spacing of the closed-path points, without and with RTS

The paper shows curves: errors of the filter grow and shrink with the travel, the three spacings coincide in A1,
where no point is closed yet, smoother curves with closer points, and RTS better on all axes at every spacing.
"""


def why_intervals(results: Results) -> str:
    """What agrees and what does not."""
    logs = [f"interval {i}" for i in (2, 6, 10)]
    alone = [results.rms_3d_m(log, "ekf matched") for log in logs]
    smoothed = [results.rms_3d_m(log, "rts-online matched") for log in logs]
    graph = [results.rms_3d_m(log, GRAPH) for log in logs]
    return f"""
- As in the paper, errors grow and shrink with the travel, the spacings coincide in A1, and RTS is better on every
  axis: rms 3-D {listed(alone)} m without and {listed(smoothed)} m with it at 2, 6 and 10 m (matched preset).
- Closer points do not make the smoother better: each counts as a fresh fix though all of a cycle share the first
  pass's error, so more of them make the filter surer (see NEES) and not closer. The graph has {listed(graph)} m.
- Scenarios of different spacing are different faces: the push errors are drawn at the points.
- RTS over the whole log and at the face ends differ little with matched sigmas. With the paper's preset the former
  is worse: one backward pass then runs over filter estimates linearised metres from the truth.
"""


CALIBRATION = """
## Figures 9, 10 and 12: biases, scale and mounting angles over time

The paper finds the same final biases with and without RTS, and RTS only calmer on the way; it has no truth for
them. Of scale and mounting angles it reports 0.017, 0.333 deg (right), -0.307 deg (up) with RTS and 0.029, 0.352
deg, 0.093 deg without. Ours are drawn anew for every seed, so their errors are what can be compared.
"""


def why_calibration(results: Results) -> str:
    """Reads the table."""
    up = [parameter for parameter, _ in results.names()].index("odometer_mounting_up")
    last = {name: results.calibration(BASE, name, lambda c: c.final)[up] for name in ("ekf matched", GRAPH)}
    return f"""
- The last biases agree with and without RTS, as they must: the smoother starts from the filter's last state. On the
  way RTS is closer to what was drawn.
- The mounting angle about forward is never observable (section 3.3 of the paper): its error stays what was
  drawn (0.5 deg), plus what misfits elsewhere push into it.
- The mounting angle about up cannot be told from the heading but by accelerations; the last estimate is
  {last["ekf matched"]:.2f} deg (filter) and {last[GRAPH]:.2f} deg (graph) off.
- With the paper's preset the filter's scale and mounting angle about up go astray: see the last section.
"""


UNCORRECTED = """
## Figures 11 and 13: navigation without corrections, by whose calibration it is told

Figure 11: pure inertial navigation over the first 300 s, before and after the biases are taken out; here from the
true state, so that biases and white noise are all that is left. Figure 13: dead reckoning after levelling at rest,
told biases, scale and mounting angles; the paper finds the horizontal error smaller with the calibration of RTS.
"""


def why_uncorrected(results: Results) -> str:
    """Reads the table."""
    nothing, own, true = (results.inertial_m(name) for name in ("nothing", "ekf matched", "true"))
    horizontal = {name: math.hypot(*results.rms_m(BASE, f"dr by {name}")[:2]) for name in FOLLOWED}
    return f"""
- Before compensation the inertial solution is lost ({nothing / 1000:,.0f} km), after it is at {own:,.0f} m. With
  the drawn biases themselves it is at {true:,.0f} m: the white noise of the gyro alone does this, so the figure
  cannot tell the estimates apart, whichever way it is drawn.
- Dead reckoning told what was drawn is no better than told the estimates: its heading is the declared one (1 deg),
  and 1 deg over 44.6 m is 0.78 m. The estimates of filter, RTS and graph differ by less than that.
- With the paper's preset the filter's calibration gives a horizontal error of {horizontal["ekf paper"]:.1f} m, that of
  RTS {horizontal["rts-online paper"]:.1f} m: better with RTS, as in the paper. With matched sigmas there is little
  between them, {horizontal["ekf matched"]:.2f} and {horizontal["rts-online matched"]:.2f} m; the graph's gives
  {horizontal[GRAPH]:.2f} m.
"""


def settings(results: Results) -> str:
    """Figures 14-15: what was done."""
    return f"""
## Figures 14 and 15: the twelve added error settings

Par 1-3: gyro bias 100 / 200 / 300 deg/h; Par 4-6: gyro white noise 1 / 2 / 3 deg/sqrt(h); Par 7-9: accelerometer
bias 1 / 2 / 3 mg; Par 10-12: accelerometer white noise 1 / 2 / 3 mg/sqrt(Hz). {results.seeds("par 1")} seeds.
Filters and graph are told the enlarged sigmas (the paper preset enlarges them again).
"""


def why_settings(results: Results) -> str:
    """The linearisation of the scale."""
    rts, graph = (results.rms_3d_m("par 12", name) for name in ("rts-online matched", GRAPH))
    scale, graph_scale = (results.last_scale_error("par 12", name) for name in ("rts-online matched", GRAPH))
    return f"""
- The paper: RTS improves every setting, and gyro biases hurt most (Par 3 and 2). Here the added biases change
  nothing: they are drawn with the root sum square of both sigmas (720 and 300 deg/h make 780), and the minute at
  rest at the start tells a constant gyro bias, whatever its size. In the paper a bias of known size was added to
  one record.
- White noise does hurt the filter and its smoother, the accelerometer's most: {rts:.2f} m at Par 12, the graph
  {graph:.3f} m. It is the odometer's scale: the last estimate is {scale:.3f} off with RTS, {graph_scale:.4f} with
  the graph. In the speed's residual, (1 + scale) times velocity, the filter takes its own predicted velocity for
  the derivative by the scale. The error of that prediction is in the residual too; the product of both has a mean,
  which pulls the scale to one side, more at every sample. A smoother behind the filter keeps the linearisation and
  with it the scale. The graph takes all residuals again at the smoothed velocities, and nothing pulls.
- This is what nonlinearity costs here. Odometer and rest carry the graph so well that the accelerometer hardly
  matters.
"""


GAINS = """
## Where the graph gains over RTS, and where it does not
"""


def why_forms(results: Results) -> str:
    """Closed path."""
    relative, absolute = results.rms_3d_m(BASE, GRAPH), results.rms_3d_m(BASE, "graph absolute")
    smoother = results.rms_3d_m(BASE, "rts-online matched")
    return f"""
**Closed path.** The graph with the papers' form of it, a point predicted from the first pass's estimate and then
taken as a measurement independent of everything else, has {absolute:.3f} m, as RTS has ({smoother:.3f} m): the same
information, counted twice, and a NEES that says so. As a relative factor, with both passes estimated, it has
{relative:.3f} m, and covariances that fit. The second pass then corrects the first, which a filter of 19
states has left behind. That is the gain of the graph over RTS in table 3.
"""


def why_agreement(results: Results) -> str:
    """No closed path."""
    ratio = {log: results.rms_3d_m(log, "rts off") / results.rms_3d_m(log, "graph off") for log in (BASE, SMALL)}
    twice = results.rms_3d_m(BASE, HALF_SECOND) / results.rms_3d_m(BASE, "graph off")
    nees = results.nees(BASE, HALF_SECOND), results.nees(BASE, "rts off")
    alone = {log: results.rms_3d_m(log, "ekf off") / results.rms_3d_m(log, "graph off") for log in (BASE, SMALL)}
    return f"""
**No closed path.** Then theory says that both agree, and they do: RTS by graph is {ratio[BASE]:.2f}. What is left
is not nonlinearity: with bias, scale, mounting and initial errors a tenth of the scenario's, everything is linear
and the ratio is {ratio[SMALL]:.2f}. It is the constraint across the machine: the filter takes it at one odometer
sample a second, the graph on the displacement of the whole second, which averages the wobble. Taken twice a second
it has {twice:.2f} of the graph's rms, and a NEES of {nees[0]:.2f} instead of {nees[1]:.2f}, since successive
samples share the wobble. The filter alone is at {alone[BASE]:.2f}, with errors a tenth {alone[SMALL]:.2f}: it does
suffer from nonlinearity, the smoother repairs that.

**Calibration.** Of the final calibration the graph has no more than the filter: both know all of the log by then.
What it has is the same calibration from the first second on, and no bias in the scale (figures 14 and 15).
"""


PRESET = """
## What the paper's preset does

The matched smoother with one of the paper's settings at a time, and all of them together.
"""


def why_preset(results: Results) -> str:
    """All together."""
    paper, matched = (results.rms_3d_m(BASE, f"rts-online {preset}") for preset in ("paper", "matched"))
    alone, median = results.rms_3d_m(BASE, "ekf paper"), results.median_rms_m(BASE, "rts-online paper")
    return f"""
No one setting explains the paper's preset ({paper:.3f} m, median run {median:.3f} m, against {matched:.3f} m);
together they do. Q x 5 lets the predicted velocity wander five times as far, P0 x 3 lets scale and mounting angles
follow, and rows at every sample count the same wobble ten times: the pull on the scale that Par 10 to 12 show
appears without added noise, and the filter alone is {alone:.1f} m off. The paper's note that Q may be enlarged for
a worn sensor costs accuracy where the sensor is as good as its data sheet, as it is here.
"""


def listed(values: tuple[float, ...] | list[float]) -> str:
    """Values with a slash between."""
    return " / ".join(f"{value:.2f}" if value >= 0.995 else f"{value:.3f}" for value in values)
