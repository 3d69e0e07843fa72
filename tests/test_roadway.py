"""The roadway's wall in the scans of a machine at rest: means, dust, and what is no wall."""

from __future__ import annotations

import numpy as np
import pytest
from roadway_walls import ANGLE_RAD, RANGE_M, ranges, wall

from factors.so3 import exp
from graphnav.errors import LogError
from graphnav.frontends.roadway import mean_scan, placed, roadway_beams
from graphnav.log import Lidar, LidarScans

STEP = np.radians(0.25)
ANGLES = np.arange(721) * STEP
SCANS = 60
LIDAR = Lidar(range_sigma_m=RANGE_M, angle_sigma_deg=float(np.degrees(ANGLE_RAD)), leg_diameter_m=0.4)
ROWS = np.arange(SCANS)
#: A machine square to the face.
SQUARE = np.eye(3)


def recorded(readings: np.ndarray) -> LidarScans:
    return LidarScans(
        t_s=np.arange(len(readings)) / 25,
        angle_min_rad=np.full(len(readings), ANGLES[0]),
        angle_step_rad=np.full(len(readings), STEP),
        ranges_m=list(readings),
    )


def face_end(legs_at_m: float = -4.0) -> np.ndarray:
    """True ranges from the end of a face: legs on the left, shields behind them, the roadway's wall ahead."""
    true = ranges(wall(np.random.default_rng(0)), np.zeros(3), ANGLES)
    shield = (legs_at_m - 1.2) / -np.sin(np.maximum(ANGLES, 1e-9))
    true = np.fmin(np.where(np.isnan(true), np.inf, true), np.where(shield * np.cos(ANGLES) < 5, shield, np.inf))
    for along in np.arange(-9.0, 6.0, 1.5):
        middle = -np.sin(ANGLES) * legs_at_m + np.cos(ANGLES) * along
        inside = middle**2 - (legs_at_m**2 + along**2 - 0.2**2)
        hit = np.where((inside > 0) & (middle > 0), middle - np.sqrt(np.maximum(inside, 0)), np.inf)
        true = np.minimum(true, hit)
    return true


def noisy(true: np.ndarray, seed: int = 0, scans: int = SCANS) -> np.ndarray:
    seen = true + RANGE_M * np.random.default_rng(seed).standard_normal((scans, len(true)))
    return np.where(np.isfinite(seen) & (seen < 30), seen, 0.0)


# Mean of the scans -------------------------------------------------------------------------------------------


def test_the_mean_of_the_scans_is_as_sure_as_it_says() -> None:
    """Mean of squares within 5 sigma of 1 over 400 beams (false-alarm rate 6e-7), of sigma itself within 1 %."""
    beams = mean_scan(recorded(noisy(np.full(400, 8.0))), ROWS, RANGE_M)
    assert abs(np.mean(((beams.range_m - 8.0) / beams.sigma_m) ** 2) - 1) < 5 * np.sqrt(2 / 400) * 1.05
    assert np.median(beams.sigma_m) == pytest.approx(RANGE_M / np.sqrt(SCANS), rel=0.03)


def test_dust_drops_out() -> None:
    readings = noisy(np.full(400, 8.0))
    rng = np.random.default_rng(1)
    readings = np.where(rng.random(readings.shape) < 0.1, rng.uniform(0.5, 8.0, readings.shape), readings)
    beams = mean_scan(recorded(readings), ROWS, RANGE_M)
    assert len(beams.range_m) == 400
    assert np.abs((beams.range_m - 8.0) / beams.sigma_m).max() < 6
    assert beams.sigma_m.max() < 2 * RANGE_M / np.sqrt(SCANS)


def test_beams_on_which_the_scans_do_not_agree_are_left_out() -> None:
    """Half of the time something is in the way, or nothing returns; the rest keep their angles."""
    readings = noisy(np.full(20, 8.0))
    readings[::2, 4] = 3.0
    readings[::2, 9] = 0.0
    readings[:, 13] = np.nan
    beams = mean_scan(recorded(readings), ROWS, RANGE_M)
    kept = np.setdiff1d(np.arange(20), [4, 9, 13])
    assert beams.angle_rad == pytest.approx(ANGLES[kept])


def test_readings_that_are_all_the_same_are_no_surer_than_one() -> None:
    """A scanner's steps hide its noise."""
    beams = mean_scan(recorded(np.full((SCANS, 20), 8.0)), ROWS, RANGE_M)
    assert (beams.sigma_m == RANGE_M).all()


def test_scans_of_different_beams_are_named() -> None:
    scans = recorded(noisy(np.full(20, 8.0)))
    angle_min = scans.angle_min_rad.copy()
    angle_min[7] += STEP
    with pytest.raises(LogError, match=r"lidar_scans, row 8, ranges_m: other beams than the scan before it"):
        mean_scan(scans.replace(angle_min_rad=angle_min), ROWS, RANGE_M)


# The roadway -------------------------------------------------------------------------------------------------


def seen(true: np.ndarray, outwards: int = 1, rot_fb: np.ndarray = SQUARE, lidar: Lidar = LIDAR) -> np.ndarray:
    """Points taken for the roadway, right and forward in the axes of the face."""
    beams = roadway_beams(recorded(noisy(true)), ROWS, lidar, np.zeros(8), rot_fb, outwards)
    return placed(beams.range_m, beams.angle_rad, lidar, np.zeros(8), rot_fb)


def test_the_wall_is_found_beside_legs_and_shields() -> None:
    points = seen(face_end())
    assert len(points) > 40
    assert points[:, 0].min() > -3.6 and points[:, 0].max() < 0.01
    assert np.abs(points[:, 1] - 12.5).max() < 0.4


def test_it_is_found_however_the_machine_stands() -> None:
    """Turned by 2 degrees, and seen from the machine's other end: the face's axes decide."""
    rot_fb = exp(np.array([0.0, 0.0, np.radians(-2.0)]))
    assert np.abs(seen(face_end(), rot_fb=rot_fb)[:, 1] - 12.5).max() < 0.5
    with pytest.raises(LogError, match=r"at 0\.0 s \d+ beams see the roadway, 12 are needed"):
        seen(face_end(), outwards=-1)


def test_a_wall_behind_the_legs_is_not_seen() -> None:
    """The machine's own conveyor ends right of them; without a wall there is nothing."""
    true = face_end()
    true[np.degrees(ANGLES) < 16] = np.inf
    with pytest.raises(LogError, match="beams see the roadway, 12 are needed; the wall must lie within"):
        seen(true)


def test_without_a_diameter_of_the_legs_it_is_asked_for() -> None:
    with pytest.raises(LogError, match="leg_diameter_m"):
        seen(face_end(), lidar=LIDAR.replace(leg_diameter_m=None))


def test_places_undo_the_scanners_errors_and_mounting() -> None:
    """Range errors taken off; the forward beam of a scanner that is turned to the left and stands aside."""
    calibration = np.array([6e-4, 0.035, 0.0, 0.0, 0.0, 0.0, 0.0, np.radians(0.5)])
    lidar = LIDAR.replace(T_bs_pos_m=np.array([0.3, -0.1, 1.0]))
    at = placed(np.array([10.0 * (1 + 6e-4) + 0.035]), np.zeros(1), lidar, calibration, np.eye(3))
    turn = np.radians(0.5)
    assert at[0] == pytest.approx([0.3 - 10 * np.sin(turn), -0.1 + 10 * np.cos(turn)], abs=1e-9)
