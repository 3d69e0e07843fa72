"""Measurements from true motion: machine wobble, inertial samples, odometer."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from graphnav.simulation.motion import Motion

Array = npt.NDArray[np.float64]

EARTH_RATE_RAD_S = 7.292115e-5
STANDARD_GRAVITY_M_S2 = 9.80665
WOBBLE_TIME_S = 0.25  # see `wobble`


def wobble(rng: np.random.Generator, count: int, dt_s: float, sigma_rad: float) -> Array:
    """Two independent stationary angle processes, ``(count, 2)`` rad.

    Autocorrelation ``sigma^2 (1 + |t|/tau) exp(-|t|/tau)``: low-pass twice, so the angular rate is
    continuous. With tau = 0.25 s the power spectral density at zero is ``4 tau sigma^2 = sigma^2 * 1 s``,
    that of a slip drawn anew every second, which is how log.toml declares it; the band is about 1 Hz.
    The discretisation is exact: the two-state Markov process (angle and rate) is sampled, not integrated.
    Each axis has a stream of its own, so a shorter series is the start of a longer one.
    """
    decay = 1.0 / WOBBLE_TIME_S
    a = decay * dt_s
    phi = np.exp(-a) * np.array([[1 + a, dt_s], [-decay * a, 1 - a]])
    stationary = np.diag([1.0, decay**2])
    root = np.linalg.cholesky(stationary - phi @ stationary @ phi.T)
    burn = int(np.ceil(20 / a))  # started at zero, stationary to exp(-20) afterwards
    angles = np.empty((count, 2))
    for axis, stream in enumerate(rng.spawn(2)):
        noise = stream.standard_normal((count + burn + 2, 2)) @ root.T
        drive = noise[1:-1, 0] - phi[1, 1] * noise[:-2, 0] + phi[0, 1] * noise[:-2, 1]
        angles[:, axis] = sigma_rad * lfilter([1.0], [1.0, -np.trace(phi), np.exp(-2 * a)], drive)[burn:]
    return angles


def wobbling(motion: Motion, angles_rad: Array, nominal_m_s: float) -> Rotation:
    """Machine attitudes ``R_nm`` with the wobble: pitch about right, crab about up.

    The origin stays on the path, so the machine frame sees ``v_m = v (crab, 1, -pitch)`` to first order:
    the slip of the log format. A smooth step of the speed makes it vanish at rest without a jump in rate.
    """
    share = moving_share(motion, nominal_m_s)
    vectors = np.zeros((len(share), 3))
    vectors[:, 0], vectors[:, 2] = share * angles_rad[:, 0], share * angles_rad[:, 1]
    return motion.rot_nm * Rotation.from_rotvec(vectors)


def moving_share(motion: Motion, nominal_m_s: float) -> Array:
    """Share of a vibration ``(N,)``: all of it at nominal speed, none at rest, a smooth step of the speed between."""
    ratio = np.minimum(np.abs(motion.speed_m_s) / nominal_m_s, 1.0)
    share: Array = ratio**2 * (3 - 2 * ratio)
    return share


def earth_rate_n(latitude_deg: float) -> Array:
    """Rotation of the Earth in n (east, north, up), rad/s."""
    latitude = np.deg2rad(latitude_deg)
    return np.array([0.0, EARTH_RATE_RAD_S * np.cos(latitude), EARTH_RATE_RAD_S * np.sin(latitude)])


def inertial_samples(
    motion: Motion, rot_nb: Rotation, dt_s: float, earth_n: Array, gravity_m_s2: float
) -> tuple[Array, Array]:
    """Error-free gyro and accelerometer samples between consecutive states.

    Sample k is the constant rate, and the constant specific force in the turning body, that carry state k
    exactly to state k + 1 in a frame fixed to the rotating Earth::

        R_k+1 = Exp(-Omega dt) R_k Exp(w dt)
        v_k+1 = v_k + (g dt - 2 Omega x (p_k+1 - p_k)) + R_k Jl(theta) f dt,   theta = Log(R_k' R_k+1)

    (`Jl`: left Jacobian of SO(3)), so that strapdown integration returns to the truth.

    Returns
    -------
    gyro_b_rad_s, accel_b_m_s2 : ``(N-1, 3)`` each, for N states.
    """
    from_inv = rot_nb[:-1].inv()
    turn = from_inv * rot_nb[1:]
    gyro = (from_inv * Rotation.from_rotvec(earth_n * dt_s) * rot_nb[1:]).as_rotvec() / dt_s
    gravity_n = np.array([0.0, 0.0, -gravity_m_s2])
    change = np.diff(motion.vel_n, axis=0) + 2 * np.cross(earth_n, np.diff(motion.pos_n, axis=0))
    mean_b = from_inv.apply(change / dt_s - gravity_n)
    return gyro, _inverse_left_jacobian(turn.as_rotvec(), mean_b)


def _inverse_left_jacobian(theta: Array, x: Array) -> Array:
    """``Jl(theta)^-1 x``, row by row."""
    square = np.einsum("ij,ij->i", theta, theta)
    angle = np.sqrt(np.maximum(square, 1e-4))
    exact = (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    series = 1 / 12 + square / 720 + square**2 / 30240
    c = np.where(square > 1e-4, exact, series)
    once = np.cross(theta, x)
    inverse: Array = x - once / 2 + c[:, None] * np.cross(theta, once)
    return inverse


def forward_speed(motion: Motion, rot_nm: Rotation) -> Array:
    """Forward component of the true velocity in the machine frame, ``(N,)`` m/s."""
    forward: Array = rot_nm.inv().apply(motion.vel_n)[:, 1]
    return forward


def gyro_si(deg_h: float) -> float:
    """Convert deg/h to rad/s."""
    return deg_h * np.pi / 180 / 3600


def gyro_density_si(deg_sqrt_h: float) -> float:
    """Convert deg/sqrt(h) to rad/s/sqrt(Hz)."""
    return deg_sqrt_h * np.pi / 180 / 60


def accel_si(mg: float) -> float:
    """Convert mg to m/s^2, or mg/sqrt(Hz) to m/s^2/sqrt(Hz)."""
    return mg * 1e-3 * STANDARD_GRAVITY_M_S2
