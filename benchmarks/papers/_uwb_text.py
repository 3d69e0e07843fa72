"""The words of the IMU/UWB page; where they hold figures, these come from the outcomes."""

from __future__ import annotations

import platform

from benchmarks._report import Before
from benchmarks.papers import _uwb_published as published
from benchmarks.papers._uwb_cases import GRAPH, INFLATED
from benchmarks.papers._uwb_rows import AXES, Results, largest_angle, mean_error

TITLE = """
# Reproduction: IMU and UWB at the end of the face

Cao Bo, Wang Shibo, Ge Shirong, Lu Cheng, "Research on shearer positioning experiment based on IMU and UWB at the end
of underground coal mining working face", Coal Science and Technology 51 (2023) no. 6, 217-228: table 4 and figures 4 to
6 and 8 to 13. The paper's experiments are real, one drive at each of two sites; its recordings are not published. Here
the scenario `face-end-uwb` stands for them: its anchors, speed and rates are the paper's, its noise is chosen so that
UWB alone has about the paper's mean errors. All else is what the methods make of it.
"""


def source(results: Results, command: str, before: Before) -> str:
    """How the page was made."""
    seeds = sorted({one.seed for one in results.found})
    return f"""
This page is written by

```
{command}
```

(sources of graphnav {before.sources}, {before.machine["processor"] or platform.machine()}); do not edit it. Figures are
medians of {len(seeds)} seeds unless they say otherwise, NEES is the mean of them; pictures are of seed {seeds[0]}.
"""


METHODS = """
- *UWB alone* (`--method uwb`): every epoch of four ranges gives a position, by a closed form on both sides of the
  anchors' plane and least squares from there. Underground the anchors are nearly in a plane and noise alone puts many
  an epoch on its wrong side; the costs of both sides, summed over 20 s, vote. The paper does not say how it solves.
- *IMU + UWB* (`imu-uwb`): equations 1 to 26, 15 states, squared ranges taken for white, feedback and reset. Beside the
  paper: the Earth turns, each range counts at its own time, the tag has a lever arm, and at rest the velocity is zero
  and the gyro shows its bias. Without that last one a MEMS gyro of 720 deg/h would lose the heading by 20 deg: the tag
  is on the IMU's own vertical axis and no range tells the heading of a machine that moves at constant speed.
- *VB-UKF*: the paper's reference for it is not reachable. This is the variational Bayes adaptive filter with inverse
  Wishart noise of Sarkka and Hartikainen (2013) and the unscented transform, on positions and a nearly constant
  velocity. The paper calls it smoothing; it describes a filter, and this is one.
- *Markov errors counted* (`uwb_filter.inflate`): the same filter, told that a range's Markov error is new only every
  two of its time constants.
- *Factor graph*: `graphnav.smooth(log)`, batch, with what the log declares.
- Errors are absolute, as in the paper's equation 27, across the face (x) and up (z), at every epoch or keyframe. NEES
  is the mean of e' P^-1 e / 3: 1 is consistent, above 1 too sure of itself. No method is given the truth.
"""

HEADS = {
    "surface": "## Table 4 and figures 4 to 6: at the surface",
    "underground": "## Figures 8 to 11: underground",
}
ATTITUDE = "## Figures 12 and 13: biases and attitude"
CAPTIONS = {
    "figure-4": "Place of the tag over time at the surface, x, y and z, by method",
    "figure-5": "Absolute errors in x and z over time at the surface, by method",
    "figure-6": "Cumulative distribution of the absolute errors at the surface, by method",
    "figure-8": "Ranges less their medians before the machine moves and after it has stopped, by anchor",
    "figure-9": "Place of the tag over time underground, x, y and z, by method",
    "figure-10": "Absolute errors in x and z over time underground, by method",
    "figure-11": "Largest, mean and standard deviation of the absolute errors underground, by method",
    "figure-12": "Biases of accelerometer and gyro over time with two sigmas, and what was drawn",
    "figure-13": "Yaw, pitch and roll over time",
}


def why(results: Results, site: str) -> str:
    """What the table of a site shows."""
    lines = [f"- UWB alone has {_against(results, site, 'uwb')}: the noise was chosen to that end."]
    lines.append(
        f"- The VB-UKF leaves {_share(results, site, 'uwb-vbukf', 'uwb')} of that (x / z). It averages over the second"
        " or two in which its model believes in a velocity, so the white part of the error goes and the Markov part,"
        f" which lasts as long, stays. Its own covariance knows only white noise: NEES"
        f" {_nees(results, site, 'uwb-vbukf', 0)}."
    )
    lines.append(
        f"- IMU + UWB has {_against(results, site, 'imu-uwb')}. {_fusion(site)} Ranges with Markov errors taken for"
        f" white make it too sure of itself, NEES {_nees(results, site, 'imu-uwb', 0)}; with them counted as what they"
        f" are it is {_nees(results, site, INFLATED, 0)} at"
        f" {_share(results, site, INFLATED, 'imu-uwb')} times the error."
    )
    lines.append(
        f"- The VB-UKF on top leaves {_share(results, site, 'imu-uwb-vbukf', 'imu-uwb')} of that"
        f"{_theirs(site, 'imu-uwb-vbukf', 'imu-uwb')}: next to nothing, or a loss. What is left after the first"
        " filter moves slowly, and a second one that sees positions alone cannot tell it from motion. A gain as the"
        " paper's needs errors of the fused positions that are new from one to the next, as when a filter follows its"
        " ranges more closely than their noise warrants. Its covariance is not to be believed, NEES"
        f" {_nees(results, site, 'imu-uwb-vbukf', 0)}: it learns the noise from how positions differ from"
        " one to the next."
    )
    if results.courses(site, GRAPH):
        lines.append(
            f"- The graph has {_share(results, site, GRAPH, 'uwb')} of UWB alone (asked: 0.30), NEES"
            f" {_nees(results, site, GRAPH, 0)}: each constant and Markov error is an unknown of its own, and every"
            " state knows the ranges after it as well as those before."
        )
    return "\n".join(lines)


def _fusion(site: str) -> str:
    if site == "surface":
        return (
            "Between ranges the IMU knows the motion to millimetres, so the filter averages over many more of them; the"
            " constant and what the Markov part keeps over such a time remain, multiplied by the geometry."
        )
    return (
        "The paper's fusion leaves 0.80 / 0.81 of its UWB alone. Here the errors renew themselves every 3 s, chosen,"
        " and averaging holds against them; the paper's must have lasted longer, such as a multipath that changes only"
        " with the place of the machine. Against an error that stays, an IMU is of no use. Delays by multipath, 5 % of"
        " anchor 1's ranges, are neither declared nor gated, as in the paper (`uwb_filter.gate_sigmas` would)."
    )


def why_attitude(results: Results) -> str:
    """What the biases and angles show."""
    lines = []
    for site in ("surface", "underground"):
        known = results.median(site, "imu-uwb", largest_angle)
        counted = results.median(site, INFLATED, largest_angle)
        if known is None or counted is None:
            continue
        lines.append(
            f"- {site.capitalize()}, the largest attitude error of the paper's filter is {float(known):.2f} deg, with"
            f" Markov errors counted {float(counted):.2f} deg; the paper reports all angles within"
            f" {published.ATTITUDE_DEG:g} deg. It is the heading, declared to 1 deg: pitch and roll are gravity's."
        )
    lines.append(
        "- The heading shows in the ranges only while the machine speeds up and slows down, here at 0.02 m/s^2. Else it"
        " is what was declared at the start, and what is left of the gyro's bias after the first rest. Where Markov"
        " errors are taken for white the filter reads some of them as heading."
    )
    lines.append(
        "- The gyro's biases are those of the first rest. The paper's biases are small and steady because the drive is"
        " short; here the same. The accelerometer's horizontal biases are not separable from tilt on a level drive: an"
        " error of 3 mg is one of 0.17 deg, which the declared attitude hides."
    )
    return "\n".join(lines)


def _against(results: Results, site: str, case: str) -> str:
    """Mean error beside the paper's."""
    ours, theirs = results.median(site, case, mean_error), published.mean(site, case)
    if ours is None or theirs is None:
        return "no figure"
    pair = " / ".join(f"{ours[axis]:.3f}" for axis in AXES.values())
    return f"{pair} m (paper {theirs[0]:.3f} / {theirs[1]:.3f} m)"


def _share(results: Results, site: str, case: str, of: str) -> str:
    ours, base = results.median(site, case, mean_error), results.median(site, of, mean_error)
    if ours is None or base is None:
        return "-"
    return " / ".join(f"{ours[axis] / base[axis]:.2f}" for axis in AXES.values())


def _theirs(site: str, case: str, of: str) -> str:
    ours, base = published.mean(site, case), published.mean(site, of)
    if ours is None or base is None:
        return ""
    return f" (paper {ours[0] / base[0]:.2f} / {ours[1] / base[1]:.2f})"


def _nees(results: Results, site: str, case: str, which: int) -> str:
    value = results.nees(site, case, which)
    return "-" if value is None else f"{value:.2g}" if value < 10 else f"{value:.0f}"
