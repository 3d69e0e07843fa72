"""Error measures against cases worked out by hand, and against statistics that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from graphnav._consistency import OverRuns, band, false_alarm
from graphnav._coverage import span
from graphnav._metrics import align, nees, truth_at, truth_states
from graphnav.baselines.innovations import Innovations
from graphnav.errors import GraphnavError, LogError
from graphnav.evaluation import STRAIGHT, evaluate, withheld_error
from graphnav.log import Events, Frames, Position, SensorLog, Truth
from graphnav.report.terminal import evaluation_tables
from graphnav.trajectory import Trajectory

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def quaternions(rotvec: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(rotvec).as_quat(scalar_first=True)


def make_log(truth: Truth | None, events: Events | None = None) -> SensorLog:
    position = Position(t_s=[0.0], pos_n_m=[[0.0, 0.0, 0.0]], sigma_n_m=[[1.0, 1.0, 1.0]])
    return SensorLog(name="made", frames=Frames(latitude_deg=35.0), position=position, truth=truth, events=events)


def straight_truth(end_s: float = 100.0, speed: float = 1.0) -> Truth:
    t = np.arange(0.0, end_s + 0.05, 0.1)
    pos = np.outer(t, [0.0, speed, 0.0])
    return Truth(t_s=t, pos_n_m=pos, quat_nb=np.tile(IDENTITY, (len(t), 1)))


def trajectory_of(truth: Truth, t_s: np.ndarray, error: np.ndarray, cov: np.ndarray | None = None) -> Trajectory:
    known, pos, quat = truth_at(truth, t_s)
    assert known.all()
    return Trajectory(t_s, pos + error, quat, np.zeros((len(t_s), 3)), cov)


def test_constant_error_has_its_size_as_rms_and_no_error_after_alignment() -> None:
    truth = straight_truth()
    offset = np.array([0.3, -0.4, 1.2])
    found = evaluate(trajectory_of(truth, np.arange(101.0), offset), make_log(truth))
    np.testing.assert_allclose(found.rms_m, np.abs(offset), atol=1e-12)
    np.testing.assert_allclose(found.max_m, np.abs(offset), atol=1e-12)
    assert found.ate_unaligned_m == pytest.approx(1.3, abs=1e-12)
    assert found.ate_m == pytest.approx(0.0, abs=1e-9)
    assert found.rpe["distance"].translation_rms_m == pytest.approx(0.0, abs=1e-12)
    assert found.nees_position is None and found.nees_attitude is None and found.nees_axes is None


def test_ate_of_a_square_stretched_by_one_percent() -> None:
    # Corners at (+-1, +-1) against (+-1.01, +-1.01): alignment without scale cannot take this out, and by
    # symmetry it is the identity, so each corner keeps an error of 0.01 sqrt(2).
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    np.testing.assert_allclose(align(1.01 * corners, corners), 1.01 * corners, atol=1e-12)
    t = np.arange(4.0)
    truth = Truth(t_s=t, pos_n_m=corners, quat_nb=np.tile(IDENTITY, (4, 1)))
    found = evaluate(Trajectory(t, 1.01 * corners, np.tile(IDENTITY, (4, 1)), np.zeros((4, 3))), make_log(truth))
    assert found.ate_m == pytest.approx(0.01 * np.sqrt(2), abs=1e-12)


def test_alignment_undoes_any_rigid_motion_and_never_mirrors() -> None:
    rng = np.random.default_rng(1)
    onto = rng.normal(size=(20, 3))
    rotation = Rotation.from_rotvec([0.4, -1.2, 2.0])
    np.testing.assert_allclose(align(rotation.apply(onto) + np.array([1.0, 2.0, 3.0]), onto), onto, atol=1e-12)
    mirrored = onto * [1.0, 1.0, -1.0]
    assert np.abs(align(mirrored, onto) - onto).max() > 0.1
    flat = onto * [1.0, 1.0, 0.0]  # the plane leaves the sign of the third singular vector open
    np.testing.assert_allclose(align(rotation.apply(flat), flat), flat, atol=1e-12)


def test_rpe_of_a_scale_error_is_that_share_of_the_distance() -> None:
    truth = straight_truth()
    t = np.arange(101.0)
    scaled = np.outer(t, [0.0, 0.02, 0.0])  # 2 % too long: 0.2 m over 10 m of truth, and over 10 s
    found = evaluate(trajectory_of(truth, t, scaled), make_log(truth)).rpe
    for name in ("distance", "time"):
        assert found[name].delta == 10.0
        assert found[name].pairs == 91
        assert found[name].translation_rms_m == pytest.approx(0.2, abs=1e-9)
        assert found[name].rotation_rms_deg == pytest.approx(0.0, abs=1e-9)
    assert set(found["distance"].to_dict()) == {"delta_m", "pairs", "translation_rms_m", "rotation_rms_deg"}


def test_rpe_of_a_turning_error() -> None:
    # The estimate's heading creeps by 0.01 rad/s; a step of 10 m along the body is then misjudged by a turn
    # of 0.1 rad in attitude, and in translation by 10 m seen from a body that is turned by the error so far.
    truth = straight_truth()
    t = np.arange(101.0)
    heading = np.outer(t, [0.0, 0.0, 0.01])
    found = evaluate(
        Trajectory(t, np.outer(t, [0.0, 1.0, 0.0]), quaternions(heading), np.zeros((101, 3))), make_log(truth)
    ).rpe["distance"]
    assert found.rotation_rms_deg == pytest.approx(np.rad2deg(0.1), abs=1e-6)
    by_hand = 2 * 10 * np.sin(heading[:91, 2] / 2)  # chord between the true and the turned step
    assert found.translation_rms_m == pytest.approx(np.sqrt(np.mean(by_hand**2)), abs=1e-9)


def test_rpe_takes_a_longer_distance_where_keyframes_are_far_apart() -> None:
    truth = straight_truth(200.0, speed=15.0)
    t = np.arange(201.0)
    log = make_log(truth)
    found = evaluate(trajectory_of(truth, t, np.zeros(3)), log)
    assert found.rpe["distance"].delta == 100.0 and found.rpe["distance"].pairs > 100
    short = evaluate(trajectory_of(truth, t, np.zeros(3)), log, rpe_distance_m=10.0).rpe["distance"]
    assert (short.pairs, short.translation_rms_m) == (0, None)


def test_attitude_error_is_in_body_axes() -> None:
    truth = straight_truth()
    t = np.arange(101.0)
    true_att = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    turned = Truth(
        t_s=truth.t_s, pos_n_m=truth.pos_n_m, quat_nb=np.tile(true_att.as_quat(scalar_first=True), (1001, 1))
    )
    estimate = (true_att * Rotation.from_rotvec([0.01, 0.0, 0.0])).as_quat(scalar_first=True)
    found = evaluate(
        Trajectory(t, np.outer(t, [0.0, 1, 0]), np.tile(estimate, (101, 1)), np.zeros((101, 3))),
        make_log(turned),
    )
    np.testing.assert_allclose(found.rms_deg, np.rad2deg([0.01, 0, 0]), atol=1e-9)
    np.testing.assert_allclose(found.att_error_b_rad[0], [0.01, 0, 0], atol=1e-12)


def test_nees_of_errors_drawn_from_the_covariance() -> None:
    # 2,000 independent draws: 2000 * 3 * NEES is chi-square with 6,000 degrees of freedom. Bounds at a
    # false-alarm rate of 1e-6 per side.
    rng = np.random.default_rng(7)
    count = 2000
    truth = straight_truth(count)
    root = np.array([[0.1, 0.0, 0.0], [0.08, 0.05, 0.0], [-0.02, 0.01, 0.3]])
    att_sigma = np.array([0.001, 0.002, 0.003])
    cov = np.zeros((count, 9, 9))
    cov[:, :3, :3] = np.diag(att_sigma**2)
    cov[:, 3:6, 3:6] = root @ root.T
    t = np.arange(count) + 0.5
    _, pos, quat = truth_at(truth, t)
    att = Rotation.from_quat(quat, scalar_first=True) * Rotation.from_rotvec(rng.normal(size=(count, 3)) * att_sigma)
    drawn = Trajectory(
        t,
        pos + rng.normal(size=(count, 3)) @ root.T,
        att.as_quat(scalar_first=True),
        np.zeros((count, 3)),
        cov,
    )
    found = evaluate(drawn, make_log(truth))
    low, high = chi2.ppf([1e-6, 1 - 1e-6], 3 * count) / (3 * count)
    assert low < found.nees_position < high
    assert low < found.nees_attitude < high
    low, high = chi2.ppf([1e-6, 1 - 1e-6], count) / count
    assert all(low < value < high for value in found.nees_axes)


def test_nees_by_hand_uses_correlations_and_skips_unknown_covariances() -> None:
    cov = np.array([[[2.0, 1, 0], [1, 2, 0], [0, 0, 4]], np.full((3, 3), np.nan)])
    error = np.array([[1.0, -1, 2], [100, 100, 100]])
    # inverse of [[2,1],[1,2]] is [[2,-1],[-1,2]]/3: 6/3 from the plane and 4/4 from the third axis
    assert nees(error, cov, np.array([0.0, 1.0])) == pytest.approx((2 + 1) / 3)
    assert nees(error[1:], cov[1:], np.array([1.0])) is None
    with pytest.raises(GraphnavError, match=r"covariance at 7\.000 s is not positive definite"):
        nees(error[:1], np.diag([1.0, 1.0, -1.0])[None], np.array([7.0]))


def test_cycles_sep_is_the_median_norm_in_each_cut() -> None:
    truth = straight_truth()
    t = np.arange(101.0)
    events = Events(
        t_s=[10.0, 20.0, 30.0, 50.0, 90.0],
        kind=["cut_start", "cut_end"] * 2 + ["cut_start"],
        cycle=[1, 1, 2, 2, 3],
    )
    error = np.zeros((101, 3))
    error[10:21] = np.outer(np.arange(11), [0.03, 0.0, 0.04])  # norms 0, 0.05, ..., 0.5: median 0.25
    error[30:51, 1] = -0.7
    found = evaluate(trajectory_of(truth, t, error), make_log(truth, events))
    assert [c.cycle for c in found.per_cycle] == [1, 2]  # the third cut was not finished
    assert [c.sep_m for c in found.per_cycle] == pytest.approx([0.25, 0.7])
    np.testing.assert_allclose(found.per_cycle[0].max_m, [0.3, 0.0, 0.4], atol=1e-12)
    np.testing.assert_allclose(found.per_cycle[1].max_m, [0.0, 0.7, 0.0], atol=1e-12)
    row = found.to_dict()["per_cycle"][0]
    assert list(row) == ["cycle", "sep_m", "max_m"]
    assert found.notes == (STRAIGHT,)


def test_cycle_that_truth_covers_in_part_is_noted() -> None:
    truth = straight_truth(15.0)
    events = Events(t_s=[10.0, 20.0], kind=["cut_start", "cut_end"], cycle=[1, 1])
    t = np.arange(31.0)
    run = Trajectory(t, np.zeros((31, 3)), np.tile(IDENTITY, (31, 1)), np.zeros((31, 3)))
    found = evaluate(run, make_log(truth, events))
    assert found.notes == ("cycle 1: judged over 5 s of 10 s", STRAIGHT)
    assert found.to_dict()["keyframes"] == {"judged": 16, "of": 31}
    assert found.to_dict()["span_s"] == [0.0, 15.0]


def test_truth_is_interpolated_by_cubic_and_slerp() -> None:
    t = np.arange(0.0, 5.1, 0.5)
    pos = np.column_stack([t**3, 2 * t**2, -t])
    vel = np.column_stack([3 * t**2, 4 * t, -np.ones_like(t)])
    truth = Truth(t_s=t, pos_n_m=pos, quat_nb=quaternions(np.outer(t, [0.0, 0.3, 0.4])), vel_n_m_s=vel)
    wanted = np.array([0.1, 2.25, 4.99])
    known, found, quat = truth_at(truth, wanted)
    assert known.all()
    np.testing.assert_allclose(found, np.column_stack([wanted**3, 2 * wanted**2, -wanted]), atol=1e-12)
    exact = Rotation.from_rotvec(np.outer(wanted, [0.0, 0.3, 0.4]))
    assert (exact.inv() * Rotation.from_quat(quat, scalar_first=True)).magnitude().max() < 1e-12
    bare = Truth(t_s=t, pos_n_m=pos, quat_nb=truth.quat_nb)
    np.testing.assert_allclose(truth_at(bare, wanted)[1], found, atol=0.05)


def test_slerp_takes_the_short_way_whatever_the_sign() -> None:
    quat = quaternions(np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]])) * np.array([[1.0], [-1.0]])
    truth = Truth(t_s=[0.0, 1.0], pos_n_m=np.zeros((2, 3)), quat_nb=quat)
    middle = Rotation.from_quat(truth_at(truth, np.array([0.5]))[2], scalar_first=True)
    np.testing.assert_allclose(middle.as_rotvec()[0], [0, 0, 0.15], atol=1e-12)


def test_nothing_is_judged_outside_truth_or_in_its_gaps() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(20.0, 30.0, 0.1)])
    truth = Truth(t_s=t, pos_n_m=np.zeros((200, 3)), quat_nb=np.tile(IDENTITY, (200, 1)))
    wanted = np.array([-1.0, 0.0, 5.05, 9.9, 15.0, 20.0, 25.0, 29.9, 31.0])
    known, pos, quat = truth_at(truth, wanted)
    np.testing.assert_array_equal(known, [0, 1, 1, 1, 0, 1, 1, 1, 0])
    assert len(pos) == len(quat) == 6


def test_errors_for_what_cannot_be_judged() -> None:
    truth = straight_truth()
    run = trajectory_of(truth, np.arange(11.0), np.zeros(3))
    with pytest.raises(GraphnavError, match="made has no truth table"):
        evaluate(run, make_log(None))
    late = Trajectory(run.t_s + 1000, run.pos_n, run.quat_nb, run.vel_n)
    with pytest.raises(GraphnavError, match=r"covers 0\.000 to 100\.000 s and no keyframe of the run, 1000\.000"):
        evaluate(late, make_log(truth))
    lone = Truth(t_s=[0.0], pos_n_m=np.zeros((1, 3)), quat_nb=[IDENTITY])
    with pytest.raises(LogError, match="truth: 1 row"):
        evaluate(run, make_log(lone))


def test_withheld_positions() -> None:
    cov = np.tile(0.01 * np.eye(9), (101, 1, 1))
    t = np.arange(101.0)
    run = Trajectory(t, np.outer(t, [0.0, 1.0, 0.0]), np.tile(IDENTITY, (101, 1)), np.tile([0.0, 1, 0], (101, 1)), cov)
    when = np.array([-5.0, 10.5, 20.5, 30.5, 200.0])
    pos = np.outer(when, [0.0, 1.0, 0.0]) + np.array([0.0, 0.0, 0.3])
    found = withheld_error(run, Position(t_s=when, pos_n_m=pos, sigma_n_m=np.full((5, 3), 0.2)))
    assert found.count == 3
    assert found.rms_m == pytest.approx((0.0, 0.0, 0.3), abs=1e-9)
    assert found.rms_3d_m == pytest.approx(0.3) and found.median_3d_m == pytest.approx(0.3)
    assert found.nees_position == pytest.approx(0.09 / (0.01 + 0.04) / 3)
    outside = Position(t_s=[500.0], pos_n_m=[[0.0, 0, 0]], sigma_n_m=[[1.0, 1, 1]])
    with pytest.raises(GraphnavError, match="no withheld position"):
        withheld_error(run, outside)


# Statistics, distribution, bands ------------------------------------------------------------------------------


def test_statistics_by_hand_and_in_the_json() -> None:
    truth = straight_truth()
    error = np.zeros((4, 3))
    error[:, 0] = [0.1, 0.1, 0.3, -0.1]
    found = evaluate(trajectory_of(truth, np.arange(4.0), error), make_log(truth)).to_dict()
    position = found["statistics"]["position_m"]
    assert position["mean"] == pytest.approx([0.1, 0.0, 0.0])
    assert position["std"] == pytest.approx([np.sqrt(0.02), 0.0, 0.0])
    assert position["rms"] == found["rms_m"] == pytest.approx([np.sqrt(0.03), 0.0, 0.0])
    assert position["max"] == found["max_m"] == pytest.approx([0.3, 0.0, 0.0])
    assert set(found["statistics"]["attitude_deg"]) == {"mean", "std", "rms", "max"}
    assert found["nees_band"] is None and found["nis"] is None


def test_attitude_statistics_keep_the_sign_of_a_constant_error() -> None:
    truth = straight_truth()
    t = np.arange(11.0)
    turned = np.tile(quaternions(np.array([-0.02, 0.0, 0.01])), (11, 1))
    run = Trajectory(t, np.outer(t, [0.0, 1.0, 0.0]), turned, np.zeros((11, 3)))
    found = evaluate(run, make_log(truth)).to_dict()["statistics"]["attitude_deg"]
    assert found["mean"] == pytest.approx(np.rad2deg([-0.02, 0.0, 0.01]))
    assert found["std"] == pytest.approx([0, 0, 0], abs=1e-9)


def test_distribution_of_the_error() -> None:
    truth = straight_truth()
    t = np.arange(100.0)
    error = np.zeros((100, 3))
    error[:, 2] = np.random.default_rng(3).permutation(np.arange(1, 101)) / 100  # 0.01, 0.02 ... 1.00 in some order
    found = evaluate(trajectory_of(truth, t, error), make_log(truth))
    assert found.quantiles_m == pytest.approx([k / 10 for k in range(1, 11)])
    assert found.sep_m == pytest.approx(0.505)
    cdf = found.to_dict()["cdf"]
    assert cdf["percent"] == list(range(10, 101, 10)) and cdf["error_3d_m"] == pytest.approx(found.quantiles_m)


def test_alignment_turns_attitudes_with_the_positions() -> None:
    rng = np.random.default_rng(8)
    t = np.arange(50.0)
    pos, att = rng.normal(size=(50, 3)), Rotation.from_rotvec(rng.normal(size=(50, 3)))
    truth = Truth(t_s=t, pos_n_m=pos, quat_nb=att.as_quat(scalar_first=True))
    whole = Rotation.from_rotvec([0.0, 0.0, 0.5])
    moved = Trajectory(t, whole.apply(pos) + 7, (whole * att).as_quat(scalar_first=True), np.zeros((50, 3)))
    ape = evaluate(moved, make_log(truth)).ape
    assert ape["unaligned"].rotation_rms_deg == pytest.approx(np.rad2deg(0.5))
    assert ape["unaligned"].translation_rms_m > 7
    assert ape["aligned"].translation_rms_m == pytest.approx(0, abs=1e-12)
    assert ape["aligned"].rotation_rms_deg == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("beside_m", "known"), [(0.0, False), (0.05, False), (0.5, True)])
def test_a_straight_path_does_not_say_how_it_is_turned_about_its_line(beside_m: float, known: bool) -> None:
    # Errors of 5 cm across the line: offsets from it of rms 0.05 / sqrt(2) are lost in them, those ten times as large
    # tell the turn about it to about a seventh of a radian.
    t = np.arange(200.0)
    pos = np.column_stack([beside_m * np.sin(t / 9), t, np.zeros(200)])
    truth = Truth(t_s=t, pos_n_m=pos, quat_nb=np.tile(IDENTITY, (200, 1)))
    error = 0.05 * np.random.default_rng(4).normal(size=(200, 3)) * [1, 0, 1]
    found = evaluate(trajectory_of(truth, t, error), make_log(truth))
    turn = found.ape["aligned"].rotation_rms_deg
    assert (turn is not None) == known and (STRAIGHT in found.notes) != known
    assert turn is None or turn < np.rad2deg(1 / 7)
    assert found.ape["unaligned"].rotation_rms_deg == pytest.approx(0, abs=1e-9)
    assert found.to_dict()["ape"]["aligned"]["rotation_rms_deg"] == turn
    evaluation_tables(found)


def test_true_velocities_are_the_derivative_of_the_true_positions() -> None:
    t = np.arange(0.0, 5.1, 0.5)
    pos = np.column_stack([t**3, 2 * t**2, -t])
    vel = np.column_stack([3 * t**2, 4 * t, -np.ones_like(t)])
    truth = Truth(t_s=t, pos_n_m=pos, quat_nb=np.tile(IDENTITY, (len(t), 1)), vel_n_m_s=vel)
    wanted = np.array([0.0, 0.1, 2.25, 4.99])
    found = truth_states(truth, wanted)[3]
    np.testing.assert_allclose(found, np.column_stack([3 * wanted**2, 4 * wanted, -np.ones(4)]), atol=1e-12)


def test_band_of_one_run() -> None:
    truth = straight_truth()
    run = trajectory_of(truth, np.arange(11.0), np.zeros(3), np.tile(np.eye(9), (11, 1, 1)))
    found = evaluate(run, make_log(truth)).nees_band
    # table values: chi-square of 3 and of 1 degrees of freedom, 2.5 % to either side
    assert found["position"] == found["attitude"] == pytest.approx((0.2158 / 3, 9.3484 / 3), rel=1e-3)
    assert found["axis"] == pytest.approx((0.000982, 5.0239), rel=1e-3)


def test_nis_of_a_filter_is_in_the_evaluation(capsys: pytest.CaptureFixture[str]) -> None:
    truth = straight_truth()
    draws = np.random.default_rng(4).normal(size=500)
    kind = np.arange(500) % 2
    kept = Innovations(np.arange(500.0), kind, ("speed", "rest"), 2 * draws, np.full(500, 4.0))
    run = trajectory_of(truth, np.arange(11.0), np.zeros(3))
    judged = evaluate(run, make_log(truth), innovations=kept)
    found = judged.to_dict()["nis"]
    assert set(found) == {"all", "speed", "rest"}
    assert found["all"]["mean"] == pytest.approx(np.mean(draws**2))
    assert found["speed"]["rows"] == 250
    assert (found["all"]["low"], found["all"]["high"]) == pytest.approx(band(500))
    evaluation_tables(judged)
    assert f"NIS, rest: {found['rest']['mean']:.3f}, 95 % band" in capsys.readouterr().err


def test_false_alarm_rate_of_a_band() -> None:
    assert false_alarm(40.0, None, chi2.isf(0.05, 40) / 40) == pytest.approx(0.05)
    assert false_alarm(40.0, chi2.ppf(0.02, 40) / 40, None) == pytest.approx(0.02)
    assert false_alarm(1e6, 0.7, 1.4) < 1e-12
    assert false_alarm(12.0, *band(12.0)) == pytest.approx(0.05)


def test_mean_over_runs_knows_its_scatter() -> None:
    # 4,000 runs, each a chi-square of 6 over 6: the estimates' own relative error is about 3 %.
    draws = np.random.default_rng(5).chisquare(6, size=4000) / 6
    found = OverRuns.of(draws.tolist())
    assert found.mean == pytest.approx(1.0, abs=0.04)
    assert found.freedom == pytest.approx(6.0, rel=0.1)
    assert found.standard_error == pytest.approx(np.sqrt(2 / 6 / 4000), rel=0.1)
    assert (found.low, found.high) == pytest.approx((1 - 0.0179, 1 + 0.0179), abs=2e-3)
    assert OverRuns.of([]) is None
    assert OverRuns.of([1.2, 0.9]).standard_error is None
    assert OverRuns.of([1.2, 1.2, 1.2]).low is None


def test_a_run_of_another_log_is_refused_or_told() -> None:
    truth, t = straight_truth(), np.arange(101.0)
    log, own = make_log(truth), trajectory_of(truth, t, np.zeros(3))
    assert evaluate(own, log, run_of="made").notes == (STRAIGHT,)
    assert evaluate(own, log).notes == (STRAIGHT,)  # a run of before, which does not tell
    note, _ = evaluate(own, log, run_of="shearer").notes  # a copy of the log under another name, perhaps
    assert "log shearer" in note and "log made" in note
    longer = Trajectory(
        np.arange(600.0), *(np.repeat(each[:1], 600, axis=0) for each in (own.pos_n, own.quat_nb, own.vel_n))
    )
    with pytest.raises(GraphnavError, match=r"log shearer, 0\.000 to 599\.000 s, and log made .* 0\.000 to 100"):
        evaluate(longer, log, run_of="shearer")
    note, _ = evaluate(longer, log, run_of="made").notes
    assert note.startswith("truth covers 17 % of the keyframes")


def test_times_are_told_without_what_rounding_leaves() -> None:
    truth = straight_truth()
    t = np.r_[2.13e-16, np.arange(1.0, 101.0)]
    assert evaluate(trajectory_of(truth, t, np.zeros(3)), make_log(truth)).to_dict()["span_s"] == [0.0, 100.0]
    assert span([-2e-17, 1e3 / 7]) == "0.000 to 142.857 s"
