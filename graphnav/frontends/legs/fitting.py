"""The loops of the circle fit: Gauss-Newton over every run of beams, compiled."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.baselines._compiled import compiled
from graphnav.frontends.legs.segmentation import Int

_FEWEST = 5
#: In full view the leg's middle is half-way between the run's ends, to this share of the angle between beams.
_EDGE_STEPS = 0.3
#: Geman-McClure scale while iterating, and the limit that then parts returns of the leg from others, both in sigmas.
_ROBUST, _INLIER = 2.5, 3.5
_ROUNDS, _FINAL_ROUNDS = 8, 3
#: Least share of a run's beams that must lie on the circle.
_INLIER_SHARE = 0.75
#: Least share of those that lie on the side towards the sensor.
_FRONT_SHARE = 0.8
#: Least share of the circle's apparent width that a run covers: in full view, and with one side hidden.
_IN_VIEW, _HALF_HIDDEN = 0.6, 0.3
#: The radius that the beams themselves ask for may differ from the known one by this many of its own sigmas.
_RADIUS_SIGMAS = 3.5
#: Errors of neighbouring beams are alike (colour and gloss of the surface): all of a run say no more about the radius
#: than so many independent ones.
_INDEPENDENT = 15
#: Largest root mean square of residuals over sigma.
_WORST_RMS = 1.5


@compiled
def fit_all(
    ranges: Array, angle_min: Array, angle_step: Array,
    scan: Int, first: Int, last: Int, hidden: npt.NDArray[np.bool_], label: npt.NDArray[np.int32],
    radius: float, range_sigma: float, angle_sigma: float, section: float, out: Array, code: Int,
) -> None:  # fmt: skip
    """Centre, covariance (xx, xy, yy), beams used and reason code of every run."""
    x, y, rho = np.empty(ranges.shape[1]), np.empty(ranges.shape[1]), np.empty(ranges.shape[1])
    for k in range(len(scan)):
        row, count = scan[k], 0
        code[k] = 1
        if last[k] - first[k] < _FEWEST:
            continue
        for beam in range(first[k], last[k]):
            if label[row, beam] == k:
                angle = angle_min[row] + beam * angle_step[row]
                rho[count] = ranges[row, beam]
                x[count], y[count] = -rho[count] * np.sin(angle), rho[count] * np.cos(angle)
                count += 1
        if count < _FEWEST:
            continue
        width = np.hypot(x[count - 1] - x[0], y[count - 1] - y[0])
        if width > 2.3 * radius + 4 * range_sigma:
            code[k] = 2
            continue
        code[k] = _fit(
            x[:count], y[:count], rho[:count], hidden[k], radius, range_sigma, angle_sigma, section,
            abs(angle_step[row]), out[k],
        )  # fmt: skip


@compiled
def _fit(
    x: Array, y: Array, rho: Array, hidden: bool, radius: float, range_sigma: float, angle_sigma: float,
    section: float, step_rad: float, out: Array,
) -> int:  # fmt: skip
    """One run: its reason code; `out` filled in for a leg."""
    n = len(x) - 1
    middle = np.arctan2(-(x[0] / rho[0] + x[n] / rho[n]), y[0] / rho[0] + y[n] / rho[n])
    spread = np.inf if hidden else np.hypot(_EDGE_STEPS * step_rad, angle_sigma)
    best, cx, cy = np.inf, 0.0, 0.0
    for start in range(2):
        sx, sy = _on_chord(x, y, radius) if start == 0 else _behind_middle(x, y, radius)
        for _ in range(_ROUNDS):
            sx, sy, cost = _step(
                x, y, rho, sx, sy, radius, range_sigma, angle_sigma, section, middle, spread, True, out
            )
        if cost < best:
            best, cx, cy = cost, sx, sy
    if not np.isfinite(best):
        return 6
    for _ in range(_FINAL_ROUNDS):
        cx, cy, cost = _step(x, y, rho, cx, cy, radius, range_sigma, angle_sigma, section, middle, spread, False, out)
    if not np.isfinite(cost) or np.hypot(cx, cy) < radius:
        return 6
    return _judge(x, y, rho, cx, cy, hidden, radius, range_sigma, angle_sigma, section, step_rad, out)


@compiled
def _on_chord(x: Array, y: Array, radius: float) -> tuple[float, float]:
    """Centre of the circle through both ends of the run, on the far side: right also where one side is hidden."""
    n = len(x) - 1
    mx, my, dx, dy = (x[0] + x[n]) / 2, (y[0] + y[n]) / 2, x[n] - x[0], y[n] - y[0]
    length = max(np.hypot(dx, dy), 1e-9)
    depth = np.sqrt(max(radius**2 - length**2 / 4, 0.0))
    nx, ny = -dy / length, dx / length
    if nx * mx + ny * my < 0:
        nx, ny = -nx, -ny
    return mx + depth * nx, my + depth * ny


@compiled
def _behind_middle(x: Array, y: Array, radius: float) -> tuple[float, float]:
    """Centre a radius behind the run's middle beam: right in full view, whatever its ends are."""
    middle = len(x) // 2
    stretch = 1 + radius / np.hypot(x[middle], y[middle])
    return x[middle] * stretch, y[middle] * stretch


@compiled
def _residual(
    x: float, y: float, rho: float, cx: float, cy: float, radius: float, range_sigma: float, angle_sigma: float,
    section: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Signed distance of a return from the circle, its variance, and the outward normal there."""
    dx, dy = x - cx, y - cy
    distance = max(np.hypot(dx, dy), 1e-9)
    nx, ny = dx / distance, dy / distance
    along = (nx * x + ny * y) / rho
    across2 = max(1.0 - along * along, 0.0)
    variance = along**2 * range_sigma**2 + across2 * (rho * angle_sigma) ** 2 + section**2
    return distance - radius, variance, nx, ny


@compiled
def _step(
    x: Array, y: Array, rho: Array, cx: float, cy: float, radius: float, range_sigma: float, angle_sigma: float,
    section: float, middle: float, spread: float, robust: bool, out: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """One Gauss-Newton step of the centre; the robust cost before it, infinite where the returns leave it open.

    The direction of the centre is `middle` within `spread`, infinite where it is not known.
    """
    hxx, hxy, hyy, gx, gy, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(x)):
        error, variance, nx, ny = _residual(
            x[i], y[i], rho[i], cx, cy, radius, range_sigma, angle_sigma, section
        )  # fmt: skip
        z2 = error**2 / variance
        weight = 1 / (1 + z2 / _ROBUST**2) ** 2 if robust else 1.0 * (z2 < _INLIER**2)
        cost += z2 / (1 + z2 / _ROBUST**2)
        weight /= variance
        hxx += weight * nx * nx
        hxy += weight * nx * ny
        hyy += weight * ny * ny
        gx += weight * nx * error
        gy += weight * ny * error
    if np.isfinite(spread):
        distance = np.hypot(cx, cy)
        ux, uy = -cy / distance, cx / distance  # across the ray, towards larger angles
        error = distance * (middle - np.arctan2(-cx, cy))
        weight = 1 / (distance * spread) ** 2
        hxx, hxy, hyy = hxx + weight * ux * ux, hxy + weight * ux * uy, hyy + weight * uy * uy
        gx, gy = gx + weight * error * ux, gy + weight * error * uy
        cost += (error / (distance * spread)) ** 2
    # a little damping along the ray keeps a nearly flat arc from flying off; it vanishes beside a good fit's weight
    damping = 1e-6 * (hxx + hyy)
    hxx, hyy = hxx + damping, hyy + damping
    det = hxx * hyy - hxy * hxy
    if not det > 0:
        return cx, cy, np.inf
    dx, dy = (hyy * gx - hxy * gy) / det, (hxx * gy - hxy * gx) / det
    long = max(np.hypot(dx, dy) / (0.5 * radius), 1.0)
    out[2], out[3], out[4] = hyy / det, -hxy / det, hxx / det
    return cx + dx / long, cy + dy / long, cost


@compiled
def _judge(
    x: Array, y: Array, rho: Array, cx: float, cy: float, hidden: bool, radius: float, range_sigma: float,
    angle_sigma: float, section: float, step_rad: float, out: Array,
) -> int:  # fmt: skip
    """Whether the run is a leg with this centre."""
    n, square, seen = 0, 0.0, 0
    low, high = np.inf, -np.inf
    distance = np.hypot(cx, cy)
    # normal equations with the radius as a third unknown, the centre eliminated: what radius do the returns ask for?
    bx, by, brr, br = 0.0, 0.0, 0.0, 0.0
    for i in range(len(x)):
        error, variance, nx, ny = _residual(
            x[i], y[i], rho[i], cx, cy, radius, range_sigma, angle_sigma, section
        )  # fmt: skip
        if error**2 >= _INLIER**2 * variance:
            continue
        n += 1
        square += error**2 / variance
        seen += (nx * cx + ny * cy) < 0.3 * distance
        side = (x[i] * cy - y[i] * cx) / (rho[i] * distance)
        low, high = min(low, side), max(high, side)
        bx, by, brr, br = bx + nx / variance, by + ny / variance, brr + 1 / variance, br + error / variance
    if n < _FEWEST or n < _INLIER_SHARE * len(x) or seen < _FRONT_SHARE * n:
        return 3
    if square / n > _WORST_RMS**2:
        return 3
    covered = (high - low + step_rad) / (2 * min(radius / distance, 1.0))
    if covered < (_HALF_HIDDEN if hidden else _IN_VIEW):
        return 4
    # the centre's gradient is zero at the solution, so only the part of the radius' column beside the centre's counts
    information = brr - (bx * (out[2] * bx + out[3] * by) + by * (out[3] * bx + out[4] * by))
    if information > 0:
        change = br / information
        information *= min(1.0, _INDEPENDENT / n)
        if abs(change) > _RADIUS_SIGMAS / np.sqrt(information) and abs(change) > 0.25 * radius:
            return 5
    out[0], out[1], out[5] = cx, cy, n
    out[2], out[4] = out[2] + section**2, out[4] + section**2
    return 0
