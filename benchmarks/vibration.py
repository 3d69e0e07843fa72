"""Two-speed preintegration against GTSAM's sample-by-sample one under vibration, and the cost of both.

The body cones (its axis of rotation turns) while it shakes along all axes at the same frequency, as a cutting drum
shakes its machine. Attitude, velocity and position are known in closed form; the IMU's samples are exact 100 Hz means
of rate and specific force, so what is measured is the error of the integration alone. Takes about 10 seconds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks._report import Before, Row, parser, publish, row, say

Array = npt.NDArray[np.float64]

RATE_HZ = 100
GRAVITY_M_S2 = 9.7973
FREQUENCIES_HZ = (5.0, 8.7, 10.0, 20.0, 40.0)  # 10 and 20: whole periods in the longer minor intervals
SPANS_S = (1.0, 10.0, 60.0)
MINORS_S = (0.02, 0.05, 0.1, 0.2)
CONE_RAD = float(np.radians(0.1))
SHAKE_M_S2 = np.array([3.0, 2.0, 5.0])  # amplitudes in n, 0.2 to 0.5 g
PHASE_RAD = np.array([0.3, 1.1, 2.0])
STARTS = 8  # intervals begin at as many phases of the vibration
STRIDE = 7  # samples between those starts: no whole number of periods
COST_SPAN_S = 500.0  # as many keyframe intervals as graphnav preintegrates at a time
KINDS = (("attitude", "urad", 1e-6), ("velocity", "mm/s", 1e-3), ("position", "mm", 1e-3))


@dataclass(frozen=True)
class Shaking:
    """Motion in closed form: ``R_nb = Exp(a [cos wt, sin wt, 0])``, acceleration ``A sin(wt + phase)`` in n."""

    frequency_hz: float

    @property
    def omega(self) -> float:
        """Angular frequency, rad/s."""
        return 2 * np.pi * self.frequency_hz

    def attitude(self, t_s: Array) -> Array:
        """R_nb, (N, 3, 3)."""
        from factors import so3

        turn = self.omega * t_s
        return so3.exp(CONE_RAD * np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)]))

    def rate_b(self, t_s: Array) -> Array:
        """Angular rate in b, (N, 3) rad/s: ``w [-sin a sin wt, sin a cos wt, cos a - 1]``."""
        turn, sine = self.omega * t_s, np.sin(CONE_RAD)
        third = np.full_like(turn, -2 * np.sin(CONE_RAD / 2) ** 2)
        return self.omega * np.column_stack([-sine * np.sin(turn), sine * np.cos(turn), third])

    def accel_n(self, t_s: Array) -> Array:
        """Acceleration in n, (N, 3) m/s^2."""
        return np.asarray(SHAKE_M_S2 * np.sin(self.omega * t_s[:, None] + PHASE_RAD))

    def vel_n(self, t_s: Array) -> Array:
        """Velocity in n, (N, 3) m/s; its mean is zero."""
        return np.asarray(-SHAKE_M_S2 / self.omega * np.cos(self.omega * t_s[:, None] + PHASE_RAD))

    def pos_n(self, t_s: Array) -> Array:
        """Position in n, (N, 3) m."""
        return -self.accel_n(t_s) / self.omega**2

    def force_b(self, t_s: Array) -> Array:
        """Specific force in b, (N, 3) m/s^2."""
        force_n = self.accel_n(t_s) + np.array([0.0, 0.0, GRAVITY_M_S2])
        return np.asarray(np.einsum("nji,nj->ni", self.attitude(t_s), force_n))

    def samples(self, span_s: float) -> tuple[Array, Array, Array]:
        """Edges (N+1,), mean rate and mean specific force (N, 3) from 0 on, by Gauss quadrature to 1e-12."""
        edge = np.arange(round(span_s * RATE_HZ) + 1) / RATE_HZ
        node, weight = np.polynomial.legendre.leggauss(10)
        middle, half = (edge[1:] + edge[:-1]) / 2, 0.5 / RATE_HZ
        gyro, accel = np.zeros((len(middle), 3)), np.zeros((len(middle), 3))
        for x, w in zip(node, weight / 2, strict=True):
            gyro += w * self.rate_b(middle + half * x)
            accel += w * self.force_b(middle + half * x)
        return edge, gyro, accel


def params() -> Any:
    """GTSAM parameters without Earth rate: the n-frame of this benchmark is inertial."""
    import gtsam

    made = gtsam.PreintegrationParams.MakeSharedU(GRAVITY_M_S2)
    for name in ("Gyroscope", "Accelerometer", "Integration"):
        getattr(made, f"set{name}Covariance")(np.eye(3) * 1e-8)
    return made


def per_sample(edge: Array, gyro: Array, accel: Array) -> Any:
    """GTSAM, sample by sample."""
    import gtsam

    pim = gtsam.PreintegratedImuMeasurements(params(), gtsam.imuBias.ConstantBias())
    for f, w, dt in zip(accel, gyro, np.diff(edge).tolist(), strict=True):
        pim.integrateMeasurement(f, w, dt)
    return pim


def two_speed(edge: Array, gyro: Array, accel: Array, bounds_s: Array, minor_s: float) -> Iterator[Any]:
    """Compensated increments over `minor_s`, then GTSAM, for every interval between bounds."""
    from factors.increments import Samples, compensated_increments
    from factors.inertial import preintegrations

    zero = np.zeros((len(bounds_s) - 1, 3))
    increments = compensated_increments(Samples(edge, gyro, accel), bounds_s, minor_s)
    return preintegrations(increments, params(), zero, zero)


def errors(pim: Any, motion: Shaking, start_s: float, end_s: float) -> Array:
    """Attitude (rad), velocity (m/s) and position (m) error norms at the end, started at the exact state: (3,)."""
    import gtsam

    times = np.array([start_s, end_s])
    rotation, pos_n, vel_n = motion.attitude(times), motion.pos_n(times), motion.vel_n(times)
    state = gtsam.NavState(gtsam.Rot3(rotation[0]), pos_n[0], vel_n[0])
    end = pim.predict(state, gtsam.imuBias.ConstantBias())
    turn = gtsam.Rot3.Logmap(gtsam.Rot3(rotation[1].T @ end.attitude().matrix()))
    return np.array([np.linalg.norm(x) for x in (turn, end.velocity() - vel_n[1], end.position() - pos_n[1])])


def rms_errors(motion: Shaking, span_s: float, minor_s: float | None) -> Array:
    """`errors` as rms over `STARTS` intervals that begin at different phases; `minor_s` None for GTSAM alone.

    There is one sample more on either side than an interval covers, as a log has it.
    """
    edge, gyro, accel = motion.samples(span_s + (STRIDE * STARTS + 2) / RATE_HZ)
    count, found = round(span_s * RATE_HZ), []
    for lo in 1 + STRIDE * np.arange(STARTS):
        hi = lo + count
        if minor_s is None:
            pim = per_sample(edge[lo : hi + 1], gyro[lo:hi], accel[lo:hi])
        else:
            near = slice(lo - 1, hi + 1)
            pim = next(two_speed(edge[lo - 1 : hi + 2], gyro[near], accel[near], edge[[lo, hi]], minor_s))
        found.append(errors(pim, motion, float(edge[lo]), float(edge[hi])))
    return np.asarray(np.sqrt(np.mean(np.square(found), axis=0)))


def error_rows(frequency_hz: float, spans_s: list[float]) -> list[Row]:
    """Errors of the two-speed algorithm beside those of GTSAM alone."""
    motion, rows = Shaking(frequency_hz), []
    for span_s in spans_s:
        peer = rms_errors(motion, span_s, None)
        for minor_s in MINORS_S:
            ours = rms_errors(motion, span_s, minor_s)
            for k, (kind, unit, size) in enumerate(KINDS):
                name = f"{kind} after {span_s:g} s, {frequency_hz:g} Hz, minor {minor_s:g} s"
                rows.append(row(name, ours[k] / size, unit, peer=peer[k] / size))
        say(f"{frequency_hz:g} Hz, {span_s:g} s")
    return rows


def cost_rows(span_s: float, repeats: int = 5) -> list[Row]:
    """Microseconds per IMU sample over intervals of one second, best of a few."""
    edge, gyro, accel = Shaking(10.0).samples(span_s)
    bounds_s = np.arange(0.0, span_s + 0.5)

    def best(run: Callable[..., object], *arguments: float) -> float:
        taken = []
        for _ in range(repeats):
            began = time.perf_counter()
            run(*arguments)
            taken.append(time.perf_counter() - began)
        return min(taken) / len(gyro) * 1e6

    def all_of(minor_s: float) -> int:
        return sum(1 for _ in two_speed(edge, gyro, accel, bounds_s, minor_s))

    peer = best(lambda: per_sample(edge, gyro, accel))
    return [row(f"cost per sample, minor {m:g} s", best(all_of, m), "us", peer=peer) for m in MINORS_S]


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--spans", type=_numbers, default=list(SPANS_S), help="intervals, s (default 1,10,60)")
    args.add_argument("--frequencies", type=_numbers, default=list(FREQUENCIES_HZ), help="Hz (default 5,8.7,10,20,40)")
    args.add_argument("--cost-span", type=float, default=COST_SPAN_S, help="record that the cost is measured on, s")
    arguments, before = args.parse_args(argv), Before.now()
    rows = [r for f in arguments.frequencies for r in error_rows(f, arguments.spans)]
    rows += cost_rows(arguments.cost_span)
    publish(rows, arguments.json, before)


def _numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


if __name__ == "__main__":
    main()
