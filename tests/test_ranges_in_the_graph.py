"""UWB ranges in the graph: consistency, each range at its own time, outliers, anchors in groups, iSAM2, the bound."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from uwb_logs import ANCHORS, Errors, passing

import graphnav as gn
from graphnav._stages import Stages
from graphnav.anchor_priors import group_covariance
from graphnav.config import Config
from graphnav.evaluation import evaluate
from graphnav.frontends.rest import rest_spans
from graphnav.log import SensorLog, UwbAnchor
from graphnav.outcome import smoothed_trajectory
from graphnav.run import Run
from graphnav.simulation import simulate
from graphnav.simulation.uwb_truth import uwb_truth
from graphnav.smooth import posed
from graphnav.solution import solve_batch
from graphnav.trajectory import Trajectory

SITES = ("surface", "underground")
#: Independent pieces that the three position errors of one log are worth, as seen from the spread of NEES over seeds.
_PIECES = 5


def smoothed(log: SensorLog, method: str = "batch", **uwb: object) -> Run:
    return gn.smooth(replace(log, truth=None), Config.from_dict({"uwb": uwb}), method=method)


def rms_m(trajectory: Trajectory, log: SensorLog) -> float:
    return float(np.linalg.norm(evaluate(trajectory, log).rms_m))


@pytest.mark.parametrize("site", SITES)
def test_position_and_attitude_errors_are_as_large_as_their_covariances(site: str) -> None:
    """Mean NEES of 3 logs within 4 sigmas of 1, if a log is worth 5 independent errors: false alarm 1 in 1,000."""
    found = []
    for seed in range(3):
        log = simulate("face-end-uwb", seed=seed, site=site)
        found.append(evaluate(smoothed(log).trajectory, log))
    band = 4 * np.sqrt(2 / (3 * _PIECES))
    for nees in ([e.nees_position for e in found], [e.nees_attitude for e in found]):
        assert 1 / (1 + band) < np.mean(np.array(nees, float)) < 1 + band


@pytest.mark.parametrize("site", SITES)
def test_rest_by_ranges_does_not_reach_into_motion(site: str) -> None:
    log = simulate("face-end-uwb", seed=1, site=site)
    assert log.truth is not None and log.truth.vel_n_m_s is not None
    speed = np.linalg.norm(log.truth.vel_n_m_s, axis=1)
    for start, end in rest_spans(replace(log, truth=None)):
        assert speed[(log.truth.t_s >= start) & (log.truth.t_s <= end)].max() == 0


@pytest.mark.parametrize("site", SITES)
def test_better_than_ranges_alone(site: str) -> None:
    """Mean errors over two logs: z at most 0.30 of UWB alone as the scenario asks, x at most what the bound allows."""
    ratios = []
    for seed in (0, 1):
        log = simulate("face-end-uwb", seed=seed, site=site)
        alone = gn.smooth(replace(log, truth=None), method="uwb")
        errors = [np.abs(evaluate(t, log).error_n_m).mean(axis=0) for t in (smoothed(log).trajectory, alone.trajectory)]
        ratios.append(errors[0] / errors[1])
    x, _, z = np.mean(ratios, axis=0)
    assert z < 0.30
    assert x < (0.30 if site == "underground" else 0.45)


def test_the_start_is_found_where_the_log_declares_none() -> None:
    known, unknown = (passing(3, Errors(constant_m=0.003), known=known) for known in (True, False))
    first, second = smoothed(known).trajectory, smoothed(unknown).trajectory
    assert second.cov is not None
    apart = np.linalg.norm(first.pos_n - second.pos_n, axis=1)
    assert (apart < 4 * np.sqrt(np.trace(second.cov[:, 3:6, 3:6], axis1=1, axis2=2))).all()
    assert rms_m(second, unknown) < 0.1


def test_coarse_keyframes_lose_nothing_against_dense_ones() -> None:
    """Ranges carried by up to a second: as with 10 times denser keyframes, to a twentieth of a sigma."""
    log = passing(5, seconds=30.0)
    coarse, fine = (
        # at rest a keyframe may stray by as much as the next, however many there are
        gn.smooth(
            replace(log, truth=None),
            Config.from_dict({"keyframes": {"interval_s": interval_s}, "rest": {"use": False}}),
        ).trajectory
        for interval_s in (1.0, 0.1)
    )
    assert len(fine) > 8 * len(coarse)
    assert coarse.cov is not None
    at = np.searchsorted(fine.t_s, coarse.t_s - 1e-6)
    np.testing.assert_allclose(fine.t_s[at], coarse.t_s, atol=1e-3)
    sigma = np.sqrt(np.diagonal(coarse.cov[:, 3:6, 3:6], axis1=1, axis2=2))
    assert (np.abs(fine.pos_n[at] - coarse.pos_n) / sigma).max() < 0.05


@pytest.mark.parametrize("loss", ["geman-mcclure", "cauchy"])
def test_a_fifth_of_ranges_by_reflection(loss: str) -> None:
    """20 % NLOS up to +3 m: rms at most 1.5 times, and those left out are the bad ones."""
    clean, bad = (simulate("face-end-uwb", seed=2, site="surface", nlos_share=share) for share in (0.0, 0.2))
    problem = posed(replace(bad, truth=None), Config.from_dict({"uwb": {"loss": loss}}), Stages(None))
    solved = solve_batch(problem, Stages(None))
    assert solved.ranges_left_out is not None
    found = rms_m(smoothed_trajectory(problem, solved.result.values, None), bad)
    assert found < 1.5 * rms_m(smoothed(clean).trajectory, clean)
    late = uwb_truth("face-end-uwb", seed=2, site="surface", nlos_share=0.2).delayed
    out = np.zeros(len(late), bool)
    out[solved.ranges_left_out.row] = True
    assert (out & late).sum() > 0.99 * out.sum()
    assert (out & late).sum() > 0.95 * late.sum()


def test_ranges_left_out_are_counted_by_anchor() -> None:
    log = simulate("face-end-uwb", seed=0, site="underground")
    rejected = smoothed(log).diagnostics.rejected
    assert rejected["uwb"] == sum(count for name, count in rejected.items() if name != "uwb")
    assert rejected["uwb anchor 1"] > 0.9 * rejected["uwb"]


def test_isam2_ends_where_batch_does() -> None:
    log = simulate("face-end-uwb", seed=4, site="surface")
    batch, isam2 = smoothed(log), smoothed(log, "isam2")
    np.testing.assert_allclose(isam2.trajectory.pos_n, batch.trajectory.pos_n, atol=2e-3)
    assert isam2.diagnostics.rejected == batch.diagnostics.rejected
    assert isam2.causal is not None
    late = isam2.causal.pos_n[-50:] - batch.trajectory.pos_n[-50:]
    assert np.abs(late).max() < 0.25


def test_rms_is_near_the_bound() -> None:
    """Mean squares of three logs against the bound's: 1.15 times, as the issue asks."""
    found = [gn.bound(simulate("face-end-uwb", seed=seed, site="surface")).overall for seed in range(3)]
    assert np.sqrt(np.mean([f.rms_3d_m**2 for f in found]) / np.mean([f.bound_3d_m**2 for f in found])) < 1.15


@pytest.mark.parametrize("kind", ["causal", "smoothed"])
def test_observability_counts_ranges(kind: str) -> None:
    from graphnav.analysis import observe

    log = passing(1, seconds=20.0)
    blind = observe(log, Config.from_dict({"uwb": {"use": False}}), kind=kind)  # type: ignore[arg-type]
    seen = observe(log, kind=kind)  # type: ignore[arg-type]
    assert (seen.sigma[-1, 6:8] < 0.2 * blind.sigma[-1, 6:8]).all()
    assert seen.sigma[-1, 8] < 0.5 * blind.sigma[-1, 8]


# Anchors ----------------------------------------------------------------------------------------------------


def moved(log: SensorLog, off_n: np.ndarray, group: str | None, sigma_m: float) -> SensorLog:
    """Declare every anchor `off_n` from where it truly is."""
    assert log.uwb is not None
    anchors = tuple(UwbAnchor(a.id, a.pos_n_m + off_n, sigma_m, group) for a in log.uwb.anchor)
    return replace(log, uwb=replace(log.uwb, anchor=anchors, group_sigma_m=None if group is None else 0.5))


def test_a_group_keeps_its_shape() -> None:
    """The prior of a group: a common displacement costs little, one anchor's own much; turns about the mean."""
    log = moved(passing(0, seconds=12.0), np.zeros(3), "2", 0.001)
    assert log.uwb is not None
    cov = group_covariance(replace(log.uwb, group_turn_sigma_deg=1.0), "2", [0, 1, 2, 3])
    common = np.tile([0.0, 0.3, 0.0, 0.0], 4)
    alone = np.r_[0.0, 0.3, 0.0, 0.0, np.zeros(12)]
    assert common @ np.linalg.solve(cov, common) < 1
    assert alone @ np.linalg.solve(cov, alone) > 100
    away = ANCHORS - ANCHORS.mean(axis=0)
    turned = np.radians(1.0) * np.column_stack([np.zeros(4), -away[:, 1], away[:, 0], np.zeros(4)]).ravel()
    assert turned @ np.linalg.solve(cov, turned) == pytest.approx(1.0, rel=0.05)


def test_a_group_that_moved_is_found_from_a_known_start() -> None:
    """A carrier 0.4 m aside: with the group declared, positions stay those of the known start."""
    off = np.array([0.0, 0.4, 0.0])
    grouped = moved(passing(2), off, "2", 0.001)
    ignored = moved(passing(2), off, None, 0.001)
    assert rms_m(smoothed(grouped).trajectory, grouped) < 0.15
    assert rms_m(smoothed(ignored, loss="none").trajectory, ignored) > 0.2


def test_a_badly_surveyed_anchor_calibrates_itself() -> None:
    log = passing(4)
    assert log.uwb is not None
    first, *others = log.uwb.anchor
    wrong = UwbAnchor(first.id, first.pos_n_m + np.array([0.3, -0.2, 0.0]), 0.5)
    free = replace(log, uwb=replace(log.uwb, anchor=(wrong, *others)))
    found = smoothed(free).calibration
    places = [found[f"uwb_anchor_1_{axis}"] for axis in ("east", "north", "up")]
    for place, off in zip(places, (-0.3, 0.2, 0.0), strict=True):
        assert place.sigma is not None and abs(place.value - off) < 4 * place.sigma
    assert min(place.sigma or 1.0 for place in places) < 0.1


def test_ranges_at_one_end_of_a_face_are_right_over_cycles() -> None:
    """The odometer's scale, 5 % wrong at first, leads metres aside: the anchors' mirror image must not be taken.

    NEES of one log within 5, where the mirror image had 6.8: chance alone takes it there once in 1,000 logs.
    """
    log = simulate("shearer-mems", 1, sensors="imu,odometer,uwb")
    log = replace(log, surveyed=())
    found, bare = (evaluate(smoothed(each).trajectory, each) for each in (log, replace(log, uwb=None)))
    assert found.nees_position is not None and found.nees_position < 5
    assert np.linalg.norm(found.rms_m) < 0.7 * np.linalg.norm(bare.rms_m)
    assert found.rms_deg[2] < 0.5 * bare.rms_deg[2]


def test_a_run_keeps_what_is_left_of_every_range(tmp_path: Path) -> None:
    """As a table and a picture, beside the trajectory."""
    log = simulate("face-end-uwb", seed=2, site="surface", nlos_share=0.1)
    run = smoothed(log)
    run.save(tmp_path / "run")
    table = pq.read_table(tmp_path / "run" / "ranges.parquet").to_pydict()
    assert log.uwb is not None and run.ranges is not None
    assert len(table["t_s"]) == len(log.uwb)
    assert table["anchor"] == log.uwb.anchor_id.tolist()
    assert table["used"].count(False) == run.diagnostics.rejected["uwb"]
    late = uwb_truth("face-end-uwb", 2, site="surface", nlos_share=0.1).delayed
    residual, used = np.array(table["residual_m"]), np.array(table["used"])
    # what is left of ranges is white (1.3 cm) where they are used, and most of the delay where they are not
    assert residual[used].std() == pytest.approx(0.013, rel=0.1)
    assert np.median(residual[late]) > 1.0
    assert (tmp_path / "run" / "ranges.png").stat().st_size > 10_000
    run.save(tmp_path / "run")  # a run is replaced by a run
