"""The filter's measurement rows: derivatives of the residuals it shares with the graph, and the same numbers."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from engine_logs import simulated
from jacobians import analytic, central, random_rotation

from factors import closed_path, odometry, position, so3, stationary
from factors.earth import earth_rate_n
from factors.noise import diagonal
from graphnav.baselines import measurements as measure
from graphnav.baselines.ekf import fed_back
from graphnav.baselines.measurements import FirstPass, Rows
from graphnav.baselines.states import (
    ACCEL_BIAS,
    GYRO_BIAS,
    MOUNTING,
    PHI,
    POS,
    SCALE,
    SIZE,
    VEL,
    Nominal,
)
from graphnav.log import Odometer

ANGLES = (0.0, 1e-5, 0.3, 2.0, np.pi - 1e-7)
EARTH = earth_rate_n(35.0)
X, V, C, B = 0, 1, 2, 3


def nominal(seed: int, angle: float | None = None) -> Nominal:
    """Any state, its attitude by any angle, the mounting up to half a radian."""
    rng = np.random.default_rng(seed)
    return Nominal(
        random_rotation(rng, angle),
        rng.normal(size=3),
        10 * rng.normal(size=3),
        rng.normal(0, 0.01, 3),
        rng.normal(0, 0.1, 3),
        rng.normal(0, 0.3, 4),
    )


def errors(seed: int) -> np.ndarray:
    """A covariance of the 19 errors."""
    part = np.random.default_rng(seed).normal(0, 0.1, (SIZE, SIZE))
    return part @ part.T


def odometer(lever: list[float]) -> Odometer:
    return simulated().odometer.replace(sigma_m_s=0.02, slip_sigma_m_s=0.05, lever_arm_b_m=np.array(lever))


def odometer_at(state: Nominal, lever: list[float], constrained: bool = True) -> Rows:
    """Rows of one sample, the rate less the state's own bias."""
    rate = np.array([0.3, -0.2, 0.5]) - state.gyro_bias_b
    return measure.odometer_rows(
        state.rotation_nb[None], state.vel_n[None], state, np.array([0.31]), rate[None], odometer(lever),
        np.array([4]), np.array([constrained]),
    )  # fmt: skip


def zero_rate_at(state: Nominal) -> Rows:
    return measure.zero_rate_rows(state, np.array([0.01, -0.02, 0.005]), 2e-3, EARTH, 7)


PAST = FirstPass(nominal(50), errors(51))
ADVANCE, SIGMA = np.array([0.4, 0.1, 0.0]), np.array([0.03, 0.05, 0.04])


def closed_path_at(state: Nominal, rows: list[int], with_first: bool) -> Rows:
    return measure.closed_path_rows(state, PAST, ADVANCE, SIGMA, rows, with_first, 9)


FIX, FIX_SIGMA = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.05])

BUILDERS: dict[str, Callable[[Nominal], Rows]] = {
    "odometer": lambda s: odometer_at(s, [0.0, 0.0, 0.0]),
    "odometer with lever arm": lambda s: odometer_at(s, [0.4, -1.2, 0.7]),
    "odometer alone": lambda s: odometer_at(s, [0.4, -1.2, 0.7], constrained=False),
    "zero velocity": lambda s: measure.zero_velocity_rows(s.rotation_nb, s.vel_n, 1e-2, 3),
    "zero rate": zero_rate_at,
    "closed path": lambda s: closed_path_at(s, [0, 1, 2], False),
    "closed path across": lambda s: closed_path_at(s, [0, 2], False),
    "position": lambda s: measure.position_rows(s, FIX, FIX_SIGMA, 11),
}


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("name", BUILDERS)
def test_rows_are_the_derivative_of_the_residual(name: str, angle: float) -> None:
    """``z`` is the negative residual: an error taken out of the state changes it by ``-h x``."""
    state, build = nominal(1, angle), BUILDERS[name]
    found = build(state)
    slope = central(lambda x: build(state.corrected(x)).z, SIZE)
    assert found.h == pytest.approx(-slope, abs=1e-6 * np.abs(found.h).max())
    assert len(found.z) == len(found.h) == len(found.kind) == len(found.epoch)


def test_a_correction_takes_the_residual_away() -> None:
    """The error that explains a measurement, fed back, leaves what is of second order."""
    state = nominal(2)
    for name in ("odometer with lever arm", "zero rate", "closed path", "position"):
        rows = BUILDERS[name](state)
        x = 1e-3 * np.linalg.lstsq(rows.h, rows.z, rcond=None)[0]
        after = BUILDERS[name](state.corrected(x))
        assert np.linalg.norm(after.z - 0.999 * rows.z) < 1e-4 * np.linalg.norm(rows.z), name


# one measurement model, two estimators ----------------------------------------------------------------------


def values(state: Nominal) -> gtsam.Values:
    out = gtsam.Values()
    out.insert(X, gtsam.Pose3(gtsam.Rot3(state.rotation_nb), state.pos_n))
    out.insert(V, state.vel_n)
    out.insert(C, state.calibration)
    out.insert(B, gtsam.imuBias.ConstantBias(state.accel_bias_b, state.gyro_bias_b))
    return out


def of_the_factor(factor: gtsam.NonlinearFactor, state: Nominal) -> tuple[np.ndarray, np.ndarray]:
    """Whitened rows and right-hand side of a factor in the filter's states."""
    jacobian, z = analytic(factor, values(state))
    h, at = np.zeros((len(z), SIZE)), 0
    for key in factor.keys():
        size = {X: 6, V: 3, C: 4, B: 6}[key]
        part = jacobian[:, at : at + size]
        at += size
        if key == X:
            # theta = R' phi, and the translation is perturbed in b
            h[:, PHI], h[:, POS] = part[:, :3] @ state.rotation_nb.T, part[:, 3:] @ state.rotation_nb.T
        elif key == V:
            h[:, VEL] = part
        elif key == C:
            h[:, SCALE], h[:, MOUNTING] = part[:, 0], part[:, 1:]
        else:
            h[:, ACCEL_BIAS], h[:, GYRO_BIAS] = part[:, :3], part[:, 3:]
    return h, z


def same(found: Rows, factor: gtsam.NonlinearFactor, state: Nominal, leave: slice | None = None) -> None:
    h, z = of_the_factor(factor, state)
    mine = found.h.copy()
    if leave is not None:
        mine[:, leave] = 0.0
    assert found.z == pytest.approx(z, rel=1e-9, abs=1e-9)
    assert mine == pytest.approx(h, rel=1e-9, abs=1e-9 * np.abs(h).max())


@pytest.mark.parametrize("lever", [[0.0, 0.0, 0.0], [0.4, -1.2, 0.7]])
@pytest.mark.parametrize("angle", ANGLES)
def test_odometer_rows_are_the_graphs(angle: float, lever: list[float]) -> None:
    """All but the gyro bias in the lever arm's velocity, which the graph takes at its last estimate."""
    state = nominal(3, angle)
    device = odometer(lever)
    noise = diagonal([device.slip_sigma_m_s, device.sigma_m_s, device.slip_sigma_m_s])
    rate = np.array([0.3, -0.2, 0.5]) - state.gyro_bias_b
    factor = odometry.velocity_factor(X, V, C, 0.31, rate, noise, device.lever_arm_b_m)
    found = odometer_at(state, lever)
    same(found, factor, state, GYRO_BIAS)
    assert found.h[:, GYRO_BIAS].any() == any(lever)
    assert [measure.KINDS[k] for k in found.kind] == ["constraint", "speed", "constraint"]


@pytest.mark.parametrize("angle", ANGLES)
def test_rest_rows_are_the_graphs(angle: float) -> None:
    state = nominal(4, angle)
    # zero velocity is taken in b, where its derivative by the attitude is none of a velocity that is zero
    found, (h, z) = BUILDERS["zero velocity"](state), of_the_factor(stationary.zero_velocity_factor(V, 1e-2), state)
    assert state.rotation_nb @ found.z == pytest.approx(z)
    assert state.rotation_nb @ found.h[:, VEL] == pytest.approx(h[:, VEL], abs=1e-9)
    assert not measure.zero_velocity_rows(state.rotation_nb, np.zeros(3), 1e-2, 3).h[:, PHI].any()
    rate = np.array([0.01, -0.02, 0.005])
    same(zero_rate_at(state), stationary.zero_rate_factor(X, B, rate, EARTH, diagonal([2e-3] * 3)), state)


@pytest.mark.parametrize("angle", ANGLES)
def test_position_rows_are_the_graphs(angle: float) -> None:
    state = nominal(5, angle)
    same(BUILDERS["position"](state), position.position_factor(X, FIX, FIX_SIGMA), state)


def test_closed_path_rows_are_the_graphs_with_the_first_pass_held() -> None:
    """As the published filter has them: what the factor says of the second pass."""
    state, past = nominal(6), PAST.nominal
    held = gtsam.Values()
    held.insert(10, gtsam.Pose3(gtsam.Rot3(past.rotation_nb), past.pos_n))
    held.insert(X, gtsam.Pose3(gtsam.Rot3(state.rotation_nb), state.pos_n))
    held.insert(C, past.calibration)
    jacobian, z = analytic(closed_path.relative_factor(10, X, C, ADVANCE, diagonal(SIGMA)), held)
    found = closed_path_at(state, [0, 1, 2], False)
    assert found.z == pytest.approx(z, rel=1e-9)
    h = np.zeros((3, SIZE))
    h[:, POS] = jacobian[:, 9:12] @ state.rotation_nb.T
    assert found.h == pytest.approx(h, rel=1e-9, abs=1e-9)
    assert set(found.epoch) == {9}


@pytest.mark.parametrize("rows", [[0, 1, 2], [0, 2]])
def test_closed_path_noise_has_the_first_pass_in_it(rows: list[int]) -> None:
    """Its covariance through differences of the residual by the first pass's errors, besides the declared one."""
    state = nominal(7)

    def residual(x: np.ndarray) -> np.ndarray:
        past = PAST.nominal.corrected(x)
        return closed_path.relative_residual(past.rotation_nb, past.pos_n, state.pos_n, past.calibration, ADVANCE)[0][
            rows
        ]

    by_past = central(residual, SIZE)
    noise = np.diag(SIGMA[rows] ** 2) + by_past @ PAST.covariance @ by_past.T
    found = closed_path_at(state, rows, True)
    by_pos = (so3.exp(PAST.nominal.calibration[1:]) @ PAST.nominal.rotation_nb.T)[rows]
    # whitened by some root of the noise: h' h and h' z do not depend on which
    weight = np.linalg.inv(noise)
    assert found.h[:, POS].T @ found.h[:, POS] == pytest.approx(by_pos.T @ weight @ by_pos, rel=1e-6)
    assert found.h[:, POS].T @ found.z == pytest.approx(-by_pos.T @ weight @ residual(np.zeros(SIZE)), rel=1e-6)


# many rows --------------------------------------------------------------------------------------------------


def test_rows_of_many_samples_are_those_of_each() -> None:
    """With the constraint at some of them; rows stay in order of their epochs when parts are joined."""
    state, rng, device = nominal(8), np.random.default_rng(9), odometer([0.1, 0.2, 0.3])
    rotations = np.array([random_rotation(rng) for _ in range(5)])
    velocities, speed, rate = rng.normal(size=(5, 3)), rng.normal(size=5), rng.normal(size=(5, 3))
    constrained = np.array([True, False, False, True, False])
    args = device, np.arange(5), constrained
    together = measure.odometer_rows(rotations, velocities, state, speed, rate, *args)
    assert together.epoch.tolist() == [0, 0, 0, 1, 2, 3, 3, 3, 4]
    for k in range(5):
        one = slice(k, k + 1)
        alone = measure.odometer_rows(
            rotations[one], velocities[one], state, speed[one], rate[one], device, np.array([k]), constrained[one]
        )
        mine = together.epoch == k
        assert together.h[mine] == pytest.approx(alone.h, abs=1e-12)
        assert together.z[mine] == pytest.approx(alone.z, abs=1e-12)
        assert np.array_equal(together.kind[mine], alone.kind)
    joined = measure.joined([measure.position_rows(state, FIX, FIX_SIGMA, 2), together])
    assert (np.diff(joined.epoch) >= 0).all()
    assert len(joined.z) == 12
    # what belongs to one epoch keeps the order of the parts
    assert joined.kind[joined.epoch == 2].tolist() == [measure.POSITION] * 3 + [measure.SPEED]
    empty = measure.joined([])
    assert empty.h.shape == (0, SIZE)


# feedback ---------------------------------------------------------------------------------------------------


def test_corrections_are_undone_by_their_negatives() -> None:
    state, x = nominal(10), 0.1 * np.random.default_rng(11).normal(size=SIZE)
    back = state.corrected(x).corrected(-x)
    for name in ("vel_n", "pos_n", "gyro_bias_b", "accel_bias_b", "calibration", "rotation_nb"):
        assert getattr(back, name) == pytest.approx(getattr(state, name), abs=1e-14), name


def test_feedback_does_not_learn_what_nothing_measures() -> None:
    """Turning the whole path, ``(d x v, d, d x p)``, is unknown before a correction, and of the same shape after it.

    Were the errors of velocity and position carried over as they are, each correction would tell something of the
    heading that no sensor has seen. Only these two change, and only by the error of attitude.
    """
    before, x = nominal(13), 0.1 * np.random.default_rng(14).normal(size=SIZE)
    after = before.corrected(x)
    up = np.array([0.0, 0.0, 1.0])
    turned, expected = np.zeros((2, SIZE))
    turned[VEL], turned[PHI], turned[POS] = np.cross(up, before.vel_n), up, np.cross(up, before.pos_n)
    expected[VEL], expected[PHI], expected[POS] = np.cross(up, after.vel_n), up, np.cross(up, after.pos_n)
    reset = fed_back(before, after)
    assert reset @ turned == pytest.approx(expected, abs=1e-12)
    reset[:3, PHI] = reset[POS, PHI] = 0.0
    assert np.array_equal(reset, np.eye(SIZE))
