"""The stereo paper's methods: inertial navigation alone, stereo odometry alone, and the filter of both."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from jacobians import ANGLES, central, random_rotation
from stereo_logs import PERFECT, Errors, driving, without

from factors import so3
from graphnav import compare as compare_module
from graphnav._consistency import band
from graphnav.baselines.stereo_rows import INERTIAL, WITH_CLONE, Place, chained_rows, motion_rows
from graphnav.cli import main
from graphnav.compare import compare
from graphnav.config import Config
from graphnav.errors import ConfigError, LogError
from graphnav.evaluation import evaluate
from graphnav.frontends.motion_chain import held_chain, sightings
from graphnav.log import SensorLog, Stereo
from graphnav.methods import STEREO_METHODS
from graphnav.readers import write
from graphnav.run import Run
from graphnav.smooth import smooth

SEEDS = 20
#: Short and with a camera that drifts: a few centimetres and a degree over the log.
DRIFTING = Errors(turn_rad=2e-3, way_m=4e-3)
BESIDE = Stereo(
    fx_px=200.0, fy_px=200.0, cx_px=200.0, cy_px=100.0, baseline_m=0.1, T_bc_pos_m=[0.2, 0.5, -0.1],
    T_bc_quat_wxyz=so3.to_quaternion(so3.exp(np.array([-1.4, 0.2, 0.1]))),
)  # fmt: skip


def run_of(log: SensorLog, method: str, **chosen: object) -> Run:
    return smooth(replace(log, truth=None), Config.from_dict({"vio_filter": chosen}), method)


# Rows -------------------------------------------------------------------------------------------------------


def place(rng: np.random.Generator) -> Place:
    return Place(random_rotation(rng), rng.normal(size=3))


def test_a_chained_pose_shows_the_errors_themselves() -> None:
    rng = np.random.default_rng(0)
    here, phi, dp = place(rng), rng.normal(0, 0.3, 3), rng.normal(size=3)
    rows = chained_rows(here.corrected(phi, dp), here, 0.01, 0.1)
    np.testing.assert_allclose(rows.z, np.concatenate([phi / 0.01, dp / 0.1]), rtol=1e-9)
    x = np.zeros(INERTIAL)
    x[3:6], x[6:9] = phi, dp
    np.testing.assert_allclose(rows.h @ x, rows.z, rtol=1e-9)


@pytest.mark.parametrize("angle", ANGLES)
def test_rows_of_a_motion_are_the_derivatives(angle: float) -> None:
    """By differences over the filter's errors, for motions that turn by any angle and are off by a little."""
    rng = np.random.default_rng(1)
    start, turn, way = place(rng), random_rotation(rng, angle), rng.normal(size=3)
    here = start.moved(turn @ so3.exp(rng.normal(0, 0.05, 3)), way + rng.normal(0, 0.05, 3))
    root = rng.normal(size=(6, 6))
    cov = root @ root.T + np.eye(6)

    def left(x: np.ndarray) -> np.ndarray:
        """What the measurement leaves, when the errors are x."""
        return motion_rows(start.corrected(x[15:18], x[18:]), here.corrected(x[3:6], x[6:9]), turn, way, cov).z

    rows = motion_rows(start, here, turn, way, cov)
    np.testing.assert_allclose(rows.h, -central(left, WITH_CLONE), atol=1e-7)


def test_rows_of_a_motion_are_white() -> None:
    """A drawn motion leaves what its covariance says: 1,500 draws, beyond 4.5 sigmas once in 7,000 runs."""
    rng = np.random.default_rng(2)
    start, here = place(rng), place(rng)
    turn, way = start.rotation_nb.T @ here.rotation_nb, start.rotation_nb.T @ (here.pos_n - start.pos_n)
    root = 1e-3 * np.tril(rng.normal(size=(6, 6)) + 3 * np.eye(6))
    off = (root @ rng.standard_normal((6, 1500))).T
    drawn = [motion_rows(start, here, turn @ so3.exp(-e[:3]), way - turn @ e[3:], root @ root.T).z for e in off]
    spread = np.cov(np.array(drawn).T)
    assert np.abs(spread - np.eye(6)).max() < 4.5 * np.sqrt(2 / 1500)


# Stereo odometry alone --------------------------------------------------------------------------------------


def test_stereo_alone_is_the_motions_compounded_with_their_covariance() -> None:
    """Against the factor graph of the same motions, which has no other way to a pose: states and covariances."""
    log = replace(driving(3, stereo=BESIDE), imu=None)
    by_graph, laid = run_of(log, "batch").trajectory, run_of(log, "stereo").trajectory
    np.testing.assert_allclose(laid.t_s, by_graph.t_s)
    np.testing.assert_allclose(laid.pos_n, by_graph.pos_n, atol=1e-9)
    np.testing.assert_allclose(laid.vel_n, by_graph.vel_n, atol=1e-9)
    assert np.degrees(np.abs(so3.log(so3.transpose(laid.rotation_nb) @ by_graph.rotation_nb))).max() < 1e-6
    np.testing.assert_allclose(laid.cov, by_graph.cov, atol=1e-6 * np.abs(by_graph.cov).max(), rtol=1e-6)


def test_the_pose_is_held_in_a_gap_and_a_warning_says_so() -> None:
    log = without(driving(0, PERFECT), 40.0, 50.0)
    run = run_of(log, "stereo")
    (note,) = run.diagnostics.warnings
    assert "no motion of the camera for 10.0 s in 1 gaps, the longest 10.0 s after 40.0 s" in note
    held = run.trajectory.at(np.array([40.0, 45.0, 50.0]))
    np.testing.assert_allclose(held.pos_n, held.pos_n[[0, 0, 0]], atol=1e-9)
    near = np.searchsorted(log.truth.t_s, [40.0, 50.0])
    made = np.diff(log.truth.pos_n_m[near], axis=0)[0]
    np.testing.assert_allclose(log.truth.pos_n_m[near[1]] - held.pos_n[2], made, atol=5e-3)
    sigma = np.sqrt(np.trace(held.cov[2, 3:6, 3:6]))
    assert 0.5 * sigma < np.linalg.norm(made) < 2 * sigma


def test_a_gap_at_rest_is_no_gap() -> None:
    log = without(driving(0, PERFECT), 0.0, 18.0)
    run = run_of(log, "stereo")
    assert run.diagnostics.warnings == []
    assert run.trajectory.t_s[0] == pytest.approx(0.0, abs=1e-9)
    assert evaluate(run.trajectory, log).max_m.max() < 5e-3


def test_gaps_and_the_chain_across_them() -> None:
    log = without(driving(0, PERFECT), 30.0, 32.0)
    seen = sightings(log)
    assert np.flatnonzero(seen.begins).tolist() == [0, 60]
    chain, gaps = held_chain(seen, -1.0)
    np.testing.assert_allclose(gaps, [[-1.0, 0.0], [30.0, 32.0]])
    assert len(chain.t_s) == len(log.relative_pose) + 3
    assert (np.diff(chain.t_s) > 0).all()
    later = seen.only(seen.t_from_s >= 10.0)
    assert np.flatnonzero(later.begins).tolist() == [0, 40]


# The filter -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stereo", [None, BESIDE])
@pytest.mark.parametrize("relative", [False, True])
def test_without_errors_all_methods_find_the_way(stereo: Stereo | None, relative: bool) -> None:
    """What is left is the initial error: 1 mm a position, 0.01 deg an attitude (0.8 mm at the end of the way)."""
    log = driving(0, PERFECT, stereo=stereo)
    for method in STEREO_METHODS:
        found = evaluate(run_of(log, method, relative=relative).trajectory, log)
        assert found.max_m.max() < 5e-3, method
        assert found.max_deg.max() < 0.03, method


@cache
def ends(relative: bool, **chosen: float) -> tuple[np.ndarray, np.ndarray]:
    """NEES / 3 of position and attitude (SEEDS,) at the end of each log."""
    found = []
    for seed in range(SEEDS):
        log = driving(seed, DRIFTING, seconds=60.0, rest_s=10.0)
        states = run_of(log, "vio-kf", relative=relative, **chosen).trajectory
        turned = so3.from_quaternion(log.truth.quat_nb[-1])
        off = so3.log(states.rotation_nb[-1].T @ turned), log.truth.pos_n_m[-1] - states.pos_n[-1]
        cov = states.cov[-1]
        found.append(
            [off[1] @ np.linalg.solve(cov[3:6, 3:6], off[1]) / 3, off[0] @ np.linalg.solve(cov[:3, :3], off[0]) / 3]
        )
    position, attitude = np.array(found).T
    return position, attitude


def test_single_motions_are_consistent() -> None:
    """Mean over 20 seeds of the last keyframe's NEES, within what a consistent filter leaves in 99.9 of 100 runs."""
    low, high = band(3 * SEEDS, 0.999)
    for nees in ends(relative=True):
        assert low < nees.mean() < high


def test_a_chained_pose_taken_for_white_is_not() -> None:
    """The paper's D_k: its errors are those of all motions before, and the filter averages them away."""
    position, attitude = ends(relative=False)
    _, high = band(3 * SEEDS, 0.999)
    assert position.mean() > 2 * high
    assert attitude.mean() > 2 * high


def test_the_filter_beats_both_of_its_parts() -> None:
    """Medians over five seeds of the largest error, position and attitude."""
    logs = [driving(seed, DRIFTING) for seed in range(5)]

    def largest(method: str, **chosen: object) -> tuple[float, float]:
        found = [evaluate(run_of(log, method, **chosen).trajectory, log) for log in logs]
        return float(np.median([f.max_m.max() for f in found])), float(np.median([f.max_deg.max() for f in found]))

    sins, stereo, both = largest("sins"), largest("stereo"), largest("vio-kf")
    single = largest("vio-kf", relative=True)
    assert sins[0] > 4 * both[0]
    assert stereo[1] > 2 * both[1]
    assert single[0] < both[0] and single[1] < both[1]


def test_inertial_navigation_alone_uses_no_camera_and_tells_its_drift() -> None:
    log = driving(1)
    run, blind = run_of(log, "sins"), run_of(replace(log, relative_pose=None), "sins")
    np.testing.assert_allclose(run.trajectory.pos_n[-1], blind.trajectory.pos_n[-1], atol=0.05)
    found = evaluate(run.trajectory, log)
    assert found.max_m.max() > 0.2
    sigma = np.sqrt(np.diag(run.trajectory.cov[-1])[3:6])
    assert (np.abs(found.error_n_m[-1]) < 3.5 * sigma).all()
    assert set(run.diagnostics.nis) == {"all", "zero velocity", "zero rate"}
    # the standing start shows the gyro's bias far better than it was declared
    assert run.calibration["gyro_bias_z"].sigma < 0.5 * log.imu.gyro_bias_deg_h


def test_without_a_standing_start_nothing_aligns() -> None:
    log = driving(1, rest_s=0.0)
    run = run_of(log, "sins")
    assert "all" not in (run.diagnostics.nis or {})
    assert run.calibration["gyro_bias_z"].sigma == pytest.approx(log.imu.gyro_bias_deg_h, rel=1e-6)


@pytest.mark.parametrize("relative", [False, True])
def test_a_gap_is_bridged_by_the_imu(relative: bool) -> None:
    """Four seconds without a motion: the pose held is off by the way made, the filter's by less than a third."""
    log = driving(2)
    lost = without(log, 50.0, 54.0)
    bridged = evaluate(run_of(lost, "vio-kf", relative=relative).trajectory, log)
    held = evaluate(run_of(lost, "stereo").trajectory, log)
    assert held.max_m.max() > 0.3
    assert bridged.max_m.max() < 0.33 * held.max_m.max()


def test_how_often_keyframes_are_makes_no_difference() -> None:
    log, found = driving(3), []
    for interval_s in (1.0, 0.13):
        config = Config.from_dict({"keyframes": {"interval_s": interval_s}, "vio_filter": {"relative": True}})
        found.append(smooth(replace(log, truth=None), config, "vio-kf").trajectory.pos_n[-1])
    assert np.abs(found[1] - found[0]).max() < 5e-3


# Methods ----------------------------------------------------------------------------------------------------


def test_motions_that_overlap_are_refused() -> None:
    log = driving(0)
    poses = log.relative_pose
    wrong = replace(log, relative_pose=poses.replace(t_from_s=poses.t_from_s - 0.2 * (np.arange(len(poses)) > 20)))
    for method in ("stereo", "vio-kf"):
        with pytest.raises(LogError, match=r"row 22, t_from_s: .* nothing bridges an overlap"):
            smooth(replace(wrong, truth=None), method=method)


@pytest.mark.parametrize("method", ["stereo", "vio-kf"])
def test_a_log_without_motions_is_refused(method: str) -> None:
    with pytest.raises(LogError, match="log driving: no relative_pose table, which this method needs; add"):
        smooth(replace(driving(0), relative_pose=None, truth=None), method=method)


def test_what_else_is_missing_is_named() -> None:
    log = replace(driving(0), truth=None)
    with pytest.raises(LogError, match=r"\[initial\]: missing"):
        smooth(replace(log, initial=None), method="stereo")
    for method in ("sins", "vio-kf"):
        with pytest.raises(ConfigError, match=f"{method} needs an IMU"):
            smooth(replace(log, imu=None), method=method)


def test_motions_at_rest_count_for_nothing_and_a_warning_says_so() -> None:
    run = run_of(without(driving(0), 18.0, 1000.0), "vio-kf")
    assert any("no motion of the camera counts" in text for text in run.diagnostics.warnings)


def test_compare_has_them_by_default_where_there_is_a_camera() -> None:
    log = driving(0, seconds=30.0)
    assert set(STEREO_METHODS) <= set(compare_module._every(log))
    assert not set(STEREO_METHODS) & set(compare_module._every(replace(log, relative_pose=None)))
    rows = compare(log, STEREO_METHODS).rows
    assert all(row.converged and row.nees_position is not None for row in rows)


def test_command_line(tmp_path: Path) -> None:
    write(driving(0, seconds=30.0, stereo=BESIDE), tmp_path / "log")
    for method in STEREO_METHODS:
        assert main(["smooth", str(tmp_path / "log"), "-o", str(tmp_path / method), "--method", method]) == 0
        summary = json.loads((tmp_path / method / "summary.json").read_text(encoding="utf-8"))
        assert summary["method"] == method
