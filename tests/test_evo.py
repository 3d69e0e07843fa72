"""Pose errors against evo, an independent implementation (GPL-3: used by these tests alone, never imported)."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.metrics import PoseRelation
from evo.core.trajectory import PosePath3D
from scipy.spatial.transform import Rotation

from graphnav.evaluation import Evaluation, evaluate
from graphnav.log import Frames, Position, SensorLog, Truth
from graphnav.trajectory import Trajectory

COUNT, STEPS = 400, 10


def walk(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Positions and quaternions (w, x, y, z) of a random walk in position and attitude."""
    pos = np.cumsum(rng.normal(scale=0.4, size=(COUNT, 3)), axis=0)
    turns = Rotation.from_rotvec(rng.normal(scale=0.2, size=(COUNT, 3)))
    attitude = [Rotation.identity()]
    for turn in turns[1:]:
        attitude.append(attitude[-1] * turn)
    return pos, Rotation.concatenate(attitude).as_quat(scalar_first=True)


@pytest.fixture(scope="module")
def pair() -> tuple[Truth, Trajectory]:
    """A random walk, and an estimate whose errors wander and that is moved and turned as a whole."""
    rng = np.random.default_rng(20)
    t = np.arange(float(COUNT))
    pos, quat = walk(rng)
    wander = np.cumsum(rng.normal(scale=0.05, size=(COUNT, 3)), axis=0)
    turned = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.01, size=(COUNT, 3)), axis=0))
    whole = Rotation.from_rotvec([0.3, -0.2, 0.8])
    found = whole.apply(pos + wander) + np.array([3.0, -2.0, 1.0])
    attitude = whole * Rotation.from_quat(quat, scalar_first=True) * turned
    estimate = Trajectory(t, found, attitude.as_quat(scalar_first=True), np.zeros((COUNT, 3)))
    return Truth(t_s=t, pos_n_m=pos, quat_nb=quat), estimate


@pytest.fixture(scope="module")
def ours(pair: tuple[Truth, Trajectory]) -> Evaluation:
    truth, estimate = pair
    position = Position(t_s=[0.0], pos_n_m=[[0.0, 0.0, 0.0]], sigma_n_m=[[1.0, 1.0, 1.0]])
    log = SensorLog(name="walk", frames=Frames(latitude_deg=35.0), position=position, truth=truth)
    return evaluate(estimate, log)


def path(pos: np.ndarray, quat: np.ndarray) -> PosePath3D:
    return PosePath3D(positions_xyz=pos, orientations_quat_wxyz=quat)


def theirs(metric: object, pair: tuple[Truth, Trajectory], aligned: bool) -> float:
    truth, estimate = pair
    reference, found = path(truth.pos_n_m, truth.quat_nb), path(estimate.pos_n, estimate.quat_nb)
    if aligned:
        found.align(reference)
    metric.process_data((reference, found))
    return metric.get_statistic(evo_metrics.StatisticsType.rmse)


@pytest.mark.parametrize("aligned", [True, False])
def test_absolute_pose_error(pair: tuple[Truth, Trajectory], ours: Evaluation, aligned: bool) -> None:
    found = ours.ape["aligned" if aligned else "unaligned"]
    translation = theirs(evo_metrics.APE(PoseRelation.translation_part), pair, aligned)
    rotation = theirs(evo_metrics.APE(PoseRelation.rotation_angle_deg), pair, aligned)
    assert found.translation_rms_m == pytest.approx(translation, rel=1e-9)
    assert found.rotation_rms_deg == pytest.approx(rotation, rel=1e-6)
    assert translation > 0.1 and rotation > 1  # the pair differs by more than round-off


@pytest.mark.parametrize("aligned", [True, False])
def test_relative_pose_error_is_the_same_aligned_or_not(
    pair: tuple[Truth, Trajectory], ours: Evaluation, aligned: bool
) -> None:
    # Keyframes are 1 s apart, so our pairs 10 s apart are evo's pairs of 10 frames.
    options = {"delta": STEPS, "delta_unit": evo_metrics.Unit.frames, "all_pairs": True}
    translation = theirs(evo_metrics.RPE(PoseRelation.translation_part, **options), pair, aligned)
    rotation = theirs(evo_metrics.RPE(PoseRelation.rotation_angle_deg, **options), pair, aligned)
    found = ours.rpe["time"]
    assert (found.delta, found.pairs) == (STEPS, COUNT - STEPS)
    assert found.translation_rms_m == pytest.approx(translation, rel=1e-9)
    assert found.rotation_rms_deg == pytest.approx(rotation, rel=1e-6)
