"""Strapdown navigation against motions whose solution is known in closed form, and against an integrator of its own."""

from __future__ import annotations

import numpy as np
import pytest
from jacobians import random_rotation
from navigation import FAST_EARTH, GRAVITY_M_S2, HERTZ, Navigated, Start, force_b, navigate, rate_b, sampled, start
from scipy.special import j1
from strapdown import integrate, means

from factors import so3
from factors.earth import EARTH_RATE_RAD_S, earth_rate_n
from factors.increments import Samples
from graphnav.baselines import strapdown

STEP_S = 1 / HERTZ
EPS = np.finfo(float).eps
GRAVITY_N = np.array([0.0, 0.0, -GRAVITY_M_S2])


def constant(rate_b: np.ndarray, force_b: np.ndarray, seconds: float) -> Samples:
    count = round(seconds * HERTZ)
    edge = np.arange(count + 1) / HERTZ
    return Samples(edge, np.tile(rate_b, (count, 1)), np.tile(force_b, (count, 1)))


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(so3.log(a.T @ b)))


# rest on the rotating Earth ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seconds", [60.0, 600.0])
@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 35.0, 90.0])
def test_a_perfect_imu_at_rest_stays_where_it_is(latitude_deg: float, seconds: float) -> None:
    """Nothing but round-off turns it: a few eps a sample. What follows is g times that, integrated.

    Position alone has a term of the scheme: n turns by Omega h under the double integral of the force of a sample,
    which leaves ``Omega x g h^3 / 6``, 7e-6 m in ten minutes. Without Earth rate it would be kilometres.
    """
    earth = earth_rate_n(latitude_deg)
    rotation = random_rotation(np.random.default_rng(round(latitude_deg) + 90))
    samples = constant(rotation.T @ earth, rotation.T @ -GRAVITY_N, seconds)
    found = navigate(samples, [seconds / 3, seconds], start(rotation_nb=rotation), earth_n=earth)
    turned = 4 * EPS * seconds * HERTZ
    fell = GRAVITY_M_S2 * turned * seconds
    scheme = np.linalg.norm(np.cross(earth, GRAVITY_N)) * STEP_S**2 * seconds / 6
    assert np.abs(found.rotation_nb - rotation).max() < turned
    assert np.abs(found.vel_n).max() < fell
    assert np.abs(found.pos_n).max() < 1.05 * scheme + fell * seconds
    assert found.force_n == pytest.approx(np.tile(-GRAVITY_N, (2, 1)), abs=1e-9)


def test_what_earth_rate_does_at_rest() -> None:
    """Left out, the platform tilts with the Earth: ``v = g Omega cos(latitude) t^2 / 2``, eastward."""
    earth, seconds = earth_rate_n(35.0), 60.0
    samples = constant(earth, -GRAVITY_N, seconds)
    found = navigate(samples, [seconds])
    expected = GRAVITY_M_S2 * EARTH_RATE_RAD_S * np.cos(np.radians(35.0)) * seconds**2 / 2
    assert found.vel_n[0, 0] == pytest.approx(expected, rel=1e-3)
    assert found.pos_n[0, 0] == pytest.approx(expected * seconds / 3, rel=1e-3)


# constant rate, constant force ------------------------------------------------------------------------------


def second_integral(theta: np.ndarray) -> np.ndarray:
    """``int_0^1 int_0^s Exp(u theta) du ds``, (3, 3)."""
    a, k = np.linalg.norm(theta), so3.skew(theta)
    return np.eye(3) / 2 + (a - np.sin(a)) / a**3 * k + (a**2 / 2 + np.cos(a) - 1) / a**4 * k @ k


@pytest.mark.parametrize("seconds", [0.5, 2.0, 20.0])
def test_constant_rate_and_force(seconds: float) -> None:
    """Attitude to round-off; the velocity's series ends at ``(w h)^2 / 6``, the position's at ``w h / 6``."""
    rng = np.random.default_rng(3)
    rate, force = np.array([0.3, -1.0, 2.0]), np.array([1.0, 2.0, 9.8])
    at = start(rotation_nb=random_rotation(rng), vel_n=rng.normal(size=3), pos_n=rng.normal(size=3))
    found = navigate(constant(rate, force, seconds), [seconds], at)
    turned = rate * seconds
    vel = at.vel_n + GRAVITY_N * seconds + at.rotation_nb @ so3.left_jacobian(turned) @ force * seconds
    pos = at.pos_n + at.vel_n * seconds + GRAVITY_N * seconds**2 / 2
    pos += at.rotation_nb @ second_integral(turned) @ force * seconds**2
    w, f = np.linalg.norm(rate), np.linalg.norm(force)
    off_v = seconds * f * (w * STEP_S) ** 3 / 24
    off_p = seconds * f * w**2 * STEP_S**3 / 24
    assert angle(at.rotation_nb @ so3.exp(turned), found.rotation_nb[0]) < 1e-11
    assert np.linalg.norm(found.vel_n[0] - vel) < 1.01 * off_v + 1e-11
    assert np.linalg.norm(found.pos_n[0] - pos) < 1.01 * (off_v * seconds / 2 + off_p) + 1e-10


def test_free_fall_on_the_rotating_earth() -> None:
    """``v' = g - 2 Omega x v`` has a closed form; Coriolis itself is 0.1 m/s and 0.7 m here.

    The recursion is of first order in ``2 Omega h``: it neglects ``(2 Omega)^2 v h / 2`` a second.
    """
    earth, seconds, vel = earth_rate_n(35.0), 10.0, np.array([100.0, -50.0, 20.0])
    samples = constant(np.zeros(3), np.zeros(3), seconds)
    found = navigate(samples, [seconds], start(vel_n=vel), earth_n=earth)
    turn = -2 * earth * seconds
    expected = so3.exp(turn) @ vel + so3.left_jacobian(turn) @ GRAVITY_N * seconds
    # the closed form cancels to 1e-16 / turn^2 of a metre
    moved = (so3.left_jacobian(turn) @ vel + second_integral(turn) @ GRAVITY_N * seconds) * seconds
    plain = vel + GRAVITY_N * seconds
    assert np.linalg.norm(expected - plain) > 0.1
    neglected = (2 * EARTH_RATE_RAD_S) ** 2 * 150.0 * seconds * STEP_S / 2
    assert np.linalg.norm(found.vel_n[0] - expected) < neglected
    assert np.linalg.norm(found.pos_n[0] - moved) < neglected * seconds + 1e-6
    assert angle(so3.exp(-earth * seconds), found.rotation_nb[0]) < 1e-12


# vibration --------------------------------------------------------------------------------------------------


def rest_of_coning(x: float) -> float:
    """Share ``x^4 / 60 + ...`` of a^2 omega by which a compensated cone still drifts, x = omega h.

    Without compensation it drifts by ``(1 - sin x / x) / 2``; the slopes of sample means over two steps give
    ``sin x (1 - cos x) / (6 x)`` of it back.
    """
    return (1 - np.sin(x) / x) / 2 - np.sin(x) * (1 - np.cos(x)) / (6 * x)


@pytest.mark.parametrize("frequency_hz", [2.0, 5.0, 10.0])
def test_coning_drifts_as_the_closed_form_says(frequency_hz: float) -> None:
    """A cone of 1 deg for 20 s, ``R = Exp(a [cos, sin, 0])``; drift with and without compensation, to 2 %."""
    a, omega, seconds = np.radians(1.0), 2 * np.pi * frequency_hz, 20.0

    def phi(t: np.ndarray) -> np.ndarray:
        return a * np.stack([np.cos(omega * t), np.sin(omega * t), 0 * t], axis=-1)

    def rate(t: np.ndarray) -> np.ndarray:
        phi_dot = a * omega * np.stack([-np.sin(omega * t), np.cos(omega * t), 0 * t], axis=-1)
        return np.einsum("...ij,...j->...i", so3.right_jacobian(phi(t)), phi_dot)

    edge = np.arange(round(seconds * HERTZ) + 1) / HERTZ
    samples = Samples(edge, means(rate, edge), np.zeros((len(edge) - 1, 3)))
    begin, end = so3.exp(phi(np.float64(0.0))), so3.exp(phi(np.float64(seconds)))
    found = navigate(samples, [seconds], start(rotation_nb=begin), gravity_m_s2=0.0)
    crude = begin
    for turn in so3.exp(samples.gyro_b * STEP_S):
        crude = crude @ turn
    x = omega * STEP_S
    drift = so3.log(found.rotation_nb[0] @ end.T)[2] / seconds
    uncompensated = so3.log(crude @ end.T)[2] / seconds
    # the compensation is short of the cone's own turn about up, which is negative in b
    assert abs(uncompensated) == pytest.approx(a**2 * omega * (1 - np.sin(x) / x) / 2, rel=0.02)
    assert abs(drift) == pytest.approx(a**2 * omega * rest_of_coning(x), rel=0.02)
    assert drift * uncompensated > 0
    assert np.linalg.norm(so3.log(found.rotation_nb[0] @ end.T)[:2]) < 1e-4 * a


@pytest.mark.parametrize("frequency_hz", [2.0, 5.0, 10.0])
def test_sculling_rectifies_as_the_closed_form_says(frequency_hz: float) -> None:
    """Rocking about x by ``a sin`` with a force ``F sin`` along y: ``v_z = F J1(a) t`` after whole periods, exactly.

    The scheme misses the same share of ``a F`` as of a cone; without compensation it would be ``(1 - sin x / x) / 2``.
    """
    a, push, omega, seconds = np.radians(2.0), 3.0, 2 * np.pi * frequency_hz, 20.0
    edge = np.arange(round(seconds * HERTZ) + 1) / HERTZ
    zero = np.zeros_like

    def rate(t: np.ndarray) -> np.ndarray:
        return np.stack([a * omega * np.cos(omega * t), zero(t), zero(t)], axis=-1)

    def force(t: np.ndarray) -> np.ndarray:
        return np.stack([zero(t), push * np.sin(omega * t), zero(t)], axis=-1)

    samples = Samples(edge, means(rate, edge), means(force, edge))
    found = navigate(samples, [seconds], gravity_m_s2=0.0)
    exact, x = push * j1(a), omega * STEP_S
    missing = exact - found.vel_n[0, 2] / seconds
    assert missing == pytest.approx(a * push * rest_of_coning(x), rel=0.05)
    assert missing < 0.4 * a * push * (1 - np.sin(x) / x) / 2
    assert exact * seconds - found.vel_n[0, 2] > 0
    # whole periods leave nothing of the harmonics: p_z = v_z t / 2
    assert found.pos_n[0, 2] == pytest.approx(found.vel_n[0, 2] * seconds / 2, rel=1e-3)
    assert abs(found.vel_n[0, :2]).max() < 1e-3 * exact * seconds


# any smooth motion ------------------------------------------------------------------------------------------


#: Errors of attitude, velocity and position after 2 s. A sample that is cut has a curve ``w'' (u^2 - h^2 / 12) / 2``
#: the two slopes do not know: at most ``0.008 w'' h^3`` = 5e-7 rad, and g times that a second; ``(2 Omega)^2 v h / 2``
#: a second of Coriolis besides, which is 2 m/s in all with the fast Earth.
LIMITS = {False: np.array([5e-7, 1e-5, 1e-5]), True: np.array([5e-7, 1e-3, 1e-3])}


def off(found: Navigated, at: Start, begin_s: float, epochs: np.ndarray, earth: np.ndarray) -> np.ndarray:
    """Errors of attitude, velocity and position (E, 3) against the independent integrator."""
    out = []
    for e, end_s in enumerate(epochs):
        r, v, p = integrate(
            rate_b, force_b, begin_s, float(end_s), step_s=2e-3,
            rotation=at.rotation_nb, vel_n=at.vel_n, pos_n=at.pos_n, gravity_n=GRAVITY_N, earth_n=earth,
        )  # fmt: skip
        errors = angle(r, found.rotation_nb[e]), found.vel_n[e] - v, found.pos_n[e] - p
        out.append([np.linalg.norm(error) for error in errors])
    return np.array(out)


@pytest.mark.parametrize("earth", [earth_rate_n(35.0), FAST_EARTH], ids=["earth", "fast"])
def test_epochs_that_divide_samples_have_the_states_of_their_times(earth: np.ndarray) -> None:
    """Start and epochs within samples, on edges and a hair beside them."""
    rng = np.random.default_rng(4)
    at = start(rotation_nb=random_rotation(rng), vel_n=rng.normal(size=3), pos_n=rng.normal(size=3))
    samples, begin = sampled(2.0), 0.0437
    epochs = np.array([0.05, 0.0613, 0.3, 0.3000001, 0.777, 1.0, 1.5041, 1.99, 2.0])
    found = navigate(samples, epochs, at, start_s=begin, earth_n=earth)
    errors = off(found, at, begin, epochs, earth)
    assert (errors < LIMITS[earth is FAST_EARTH]).all(), errors
    once = navigate(samples, epochs[-1:], at, start_s=begin, earth_n=earth)
    # what pieces of a sample neglect is of fourth order
    assert angle(once.rotation_nb[0], found.rotation_nb[-1]) < 1e-8
    limit = LIMITS[earth is FAST_EARTH] / 100
    assert once.vel_n[0] == pytest.approx(found.vel_n[-1], abs=limit[1])
    assert once.pos_n[0] == pytest.approx(found.pos_n[-1], abs=limit[2])


def test_errors_fall_with_the_sampling_interval_as_they_should() -> None:
    """Attitude with its fourth power, velocity and position with its third (the one-sided slope at the ends: third)."""
    at = start(rotation_nb=random_rotation(np.random.default_rng(5)))
    earth, ends = earth_rate_n(35.0), np.array([1.5])
    coarse, fine = (off(navigate(sampled(2.0, f), ends, at, earth_n=earth), at, 0.0, ends, earth)[0] for f in (50, 100))
    assert coarse[0] / fine[0] > 6
    assert (coarse[1:] / fine[1:] > 6).all()


def test_biases_are_taken_out_of_the_samples() -> None:
    samples, rng = sampled(1.0), np.random.default_rng(6)
    gyro, accel = rng.normal(0, 0.02, 3), rng.normal(0, 0.2, 3)
    biased = Samples(samples.edge_s, samples.gyro_b + gyro, samples.accel_b + accel)
    earth, epochs = earth_rate_n(35.0), [0.333, 1.0]
    clean = navigate(samples, epochs, earth_n=earth)
    found = navigate(biased, epochs, start(gyro_bias_b=gyro, accel_bias_b=accel), earth_n=earth)
    for name in ("rotation_nb", "vel_n", "pos_n", "force_n"):
        assert getattr(found, name) == pytest.approx(getattr(clean, name), abs=1e-12), name
    assert angle(navigate(biased, epochs, earth_n=earth).rotation_nb[1], clean.rotation_nb[1]) > 1e-3


def test_mean_force() -> None:
    """``(v_end - v_start) / t - g + 2 Omega x dp / t`` over every epoch."""
    at = start(rotation_nb=random_rotation(np.random.default_rng(7)))
    found = navigate(sampled(1.0), [0.25, 0.5, 1.0], at, earth_n=FAST_EARTH)
    gained = np.diff(found.vel_n, axis=0, prepend=0) + 2 * np.cross(FAST_EARTH, np.diff(found.pos_n, axis=0, prepend=0))
    span = np.array([0.25, 0.25, 0.5])[:, None]
    assert found.force_n == pytest.approx(gained / span - GRAVITY_N, abs=2e-3)


def test_rest_holds_the_attitude_and_lets_the_accelerometer_speak() -> None:
    """A gyro that turns at rest is biased: the attitude stays, the force is integrated in it."""
    rotation = random_rotation(np.random.default_rng(8))
    samples = constant(np.array([0.01, 0.02, -0.03]), rotation.T @ (-GRAVITY_N + [0.1, 0.0, 0.0]), 2.0)
    found = navigate(samples, [1.0, 2.0], start(rotation_nb=rotation), earth_n=earth_rate_n(35.0), resting=True)
    assert found.rotation_nb == pytest.approx(np.stack([rotation, rotation]), abs=1e-14)
    assert found.vel_n[:, 0] == pytest.approx([0.1, 0.2], abs=1e-4)
    assert found.pos_n[:, 0] == pytest.approx([0.05, 0.2], abs=1e-4)
    # no attitude error comes from the gyro, and none turns
    names = [strapdown.BLOCKS, found.blocks.shape[1]]
    assert names[0] == names[1]
    assert found.blocks[:, 0] == pytest.approx(np.tile(np.eye(3), (2, 1, 1)))
    for block in (1, 4, 8):
        assert not found.blocks[:, block].any()
