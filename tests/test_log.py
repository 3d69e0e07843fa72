"""The data model: what a record accepts, what it refuses, and what it says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sample_logs import every_sensor_log, imu_params, initial, odometer_params, quaternions, small_log

from graphnav import log as gl
from graphnav.errors import GraphnavError, LogError


def imu(**changes) -> gl.Imu:
    values = {"t_s": [0.01, 0.02, 0.03], "gyro_b_rad_s": np.zeros((3, 3)), "accel_b_m_s2": np.ones((3, 3))}
    return gl.Imu(**(values | imu_params() | changes))


def test_arrays_are_frozen_and_the_callers_array_is_not():
    times = np.array([0.0, 1.0])
    record = gl.Odometer(t_s=times, speed_m_s=[0.1, 0.2], **odometer_params())
    with pytest.raises(ValueError, match="read-only"):
        record.t_s[0] = 5.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.t_s = times
    assert times.flags.writeable


def test_lists_of_whole_numbers_become_float_arrays():
    record = gl.Odometer(t_s=[0, 1], speed_m_s=[0, 1], **odometer_params())
    assert record.speed_m_s.dtype == np.float64
    assert record.mounting_sigma_deg.shape == (3,)
    assert len(record) == 2


def test_imu_interval_starts_one_step_before_the_first_row():
    record = imu(t_s=[0.01, 0.02, 0.03])
    assert record.dt_s == pytest.approx(0.01)
    assert record.start_s == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("changes", "fragments"),
    [
        ({"t_s": [0.01, 0.03, 0.02]}, ["table imu", "row 3", "t_s", "runs backwards", "0.02", "sort"]),
        ({"t_s": [0.01, 0.02, 0.02]}, ["row 3", "twice"]),
        ({"t_s": [0.01, np.nan, 0.03]}, ["row 2", "t_s", "nan", "finite"]),
        ({"gyro_b_rad_s": np.diag([0, np.inf, 0])}, ["row 2", "gyro_y_rad_s", "inf"]),
        ({"gyro_b_rad_s": np.zeros((3, 2))}, ["gyro_b_rad_s", "(3, 2)", "(N,3)"]),
        ({"gyro_b_rad_s": np.zeros((2, 3))}, ["different lengths"]),
        ({"accel_b_m_s2": [["a", "b", "c"]] * 3}, ["accel_x_m_s2", "not numeric"]),
        ({"gyro_bias_deg_h": 0.0}, ["gyro_bias_deg_h", "0.0", "above zero"]),
        ({"gyro_bias_walk_deg_h_sqrt_h": -1.0}, ["gyro_bias_walk_deg_h_sqrt_h", "-1.0", "zero or more"]),
        ({"accel_bias_mg": True}, ["accel_bias_mg", "True", "a number"]),
        ({"accel_bias_mg": float("nan")}, ["accel_bias_mg", "nan", "finite"]),
        ({"gyro_matrix": [1, 2, 3]}, ["gyro_matrix", "(3, 3)"]),
        ({"t_s": [], "gyro_b_rad_s": np.zeros((0, 3)), "accel_b_m_s2": np.zeros((0, 3))}, ["no rows"]),
        ({"t_s": [1.0], "gyro_b_rad_s": np.zeros((1, 3)), "accel_b_m_s2": np.ones((1, 3))}, ["at least 2"]),
    ],
)
def test_a_broken_imu_is_refused_by_row_and_column(changes, fragments):
    with pytest.raises(LogError) as caught:
        imu(**changes)
    assert all(fragment in str(caught.value) for fragment in fragments), str(caught.value)
    assert "\n" not in str(caught.value)


def test_rows_may_share_a_time_only_where_the_format_says_so():
    points = gl.LidarPoints(t_s=[0.1, 0.1], feature=[1, 2], range_m=[4.0, 5.0], angle_rad=[0.0, 0.1])
    assert len(points) == 2
    with pytest.raises(LogError, match=r"table position, row 2.*twice"):
        gl.Position(t_s=[0.1, 0.1], pos_n_m=np.zeros((2, 3)), sigma_n_m=np.ones((2, 3)))


def test_relative_poses_ascend_by_their_first_time():
    values = {"pos_m": np.zeros((2, 3)), "quat": [[1, 0, 0, 0]] * 2, "sigma_m": [1, 1], "sigma_rad": [1, 1]}
    assert len(gl.RelativePose(t_from_s=[0, 0], t_to_s=[1, 2], **values)) == 2
    with pytest.raises(LogError, match=r"t_from_s.*runs backwards"):
        gl.RelativePose(t_from_s=[1, 0], t_to_s=[2, 3], **values)
    with pytest.raises(LogError, match="no uncertainty"):
        gl.RelativePose(t_from_s=[0, 0], t_to_s=[1, 2], pos_m=np.zeros((2, 3)), quat=[[1, 0, 0, 0]] * 2)


def test_quaternions_are_normalised_once_and_for_all():
    rng = np.random.default_rng(1)
    rough = quaternions(rng, 500) * (1 + 1e-5 * rng.normal(size=(500, 1)))
    record = gl.Truth(t_s=np.arange(500.0), pos_n_m=np.zeros((500, 3)), quat_nb=rough)
    np.testing.assert_allclose(np.linalg.norm(record.quat_nb, axis=1), 1, atol=1e-15)
    again = gl.Truth(t_s=record.t_s, pos_n_m=record.pos_n_m, quat_nb=record.quat_nb)
    np.testing.assert_array_equal(again.quat_nb, record.quat_nb)


def test_a_quaternion_that_is_no_rotation_is_refused():
    quat = np.array([[1.0, 0, 0, 0], [0.9, 0, 0, 0]])
    with pytest.raises(LogError, match=r"table truth, row 2, quat_nb: quaternion of length 0.9, expected 1"):
        gl.Truth(t_s=[0, 1], pos_n_m=np.zeros((2, 3)), quat_nb=quat)
    with pytest.raises(LogError, match=r"\[initial\], quat_nb_wxyz"):
        initial(quat_nb_wxyz=[0, 0, 0, 0])


@pytest.mark.parametrize(
    ("build", "pattern"),
    [
        (lambda: gl.Frames(91.0), r"\[frames\], latitude_deg: 91.0, expected -90 to 90"),
        (lambda: gl.Frames(35.0, gravity_m_s2=1.0), r"gravity_m_s2: 1.0, expected 9.7 to 9.9"),
        (lambda: gl.SurveyedPoint(pos_n_m=[0, 0, 0], sigma_m=0.1), "either t_s or end"),
        (lambda: gl.SurveyedPoint(pos_n_m=[0, 0, 0], sigma_m=0.1, end="left"), '"left", expected "far"'),
        (lambda: gl.SurveyedPoint(pos_n_m=[0, 0], sigma_m=0.1, end="far"), r"pos_n_m.*shape \(3,\)"),
        (
            lambda: gl.Events(t_s=[0], kind=["start"], cycle=[1]),
            r'row 1, kind: "start", expected "cut_start"',
        ),
        (lambda: initial(pos_sigma_m=[0, 1, 1]), "above zero; declare the sensor's 1-sigma error"),
        (lambda: gl.SensorLog(name="empty", frames=gl.Frames(0.0)), "log empty: no motion sensor"),
    ],
)
def test_other_records_are_checked_too(build, pattern):
    with pytest.raises(LogError, match=pattern):
        build()


def test_uwb_ranges_need_declared_tags_and_anchors():
    anchor = gl.UwbAnchor(id="7", pos_n_m=[0, 0, 0], sigma_m=0.01)
    values = {"t_s": [0, 1], "range_m": [1, 2], "tag": (gl.UwbTag(id="t"),), "anchor": (anchor,)}
    assert len(gl.Uwb(tag_id=["t", "t"], anchor_id=["7", "7"], **values)) == 2
    with pytest.raises(LogError, match=r'row 2, anchor: unknown anchor "8".*\[\[uwb.anchor\]\]'):
        gl.Uwb(tag_id=["t", "t"], anchor_id=["7", "8"], **values)


def test_a_start_without_position_is_unknown():
    unknown = initial(pos_n_m=None, pos_sigma_m=None)
    assert unknown.pos_n_m.tolist() == [0, 0, 0]
    assert unknown.pos_sigma_m.tolist() == [1000, 1000, 1000]
    assert not unknown.pos_known
    assert not initial(pos_sigma_m=[1, 1, 100]).pos_known
    assert initial(pos_sigma_m=[99, 99, 99]).pos_known
    for alone in ("pos_n_m", "pos_sigma_m"):
        with pytest.raises(LogError, match=r"\[initial\]: pos_n_m and pos_sigma_m belong together; declare both"):
            initial(**{alone: None})


def test_replace_checks_again():
    record = small_log().odometer
    assert record.replace(sigma_m_s=0.5).sigma_m_s == 0.5
    with pytest.raises(LogError, match="above zero"):
        record.replace(sigma_m_s=0.0)


def test_tables_lists_what_is_there_in_the_order_of_the_format():
    assert list(small_log().tables()) == ["imu", "odometer"]
    assert list(every_sensor_log().tables()) == list(gl.TABLES)


def test_errors_are_one_line_with_place_and_fix():
    error = LogError("value nan", where="a/imu.csv", row=0, column="t_s", fix="drop it")
    assert str(error) == "a/imu.csv, row 1, t_s: value nan; drop it"
    assert str(error.at("b")) == "b, row 1, t_s: value nan; drop it"
    assert str(LogError("nothing known")) == "nothing known"
    assert isinstance(error, GraphnavError)
