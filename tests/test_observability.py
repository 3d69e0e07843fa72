"""Observability: the analysis of covariances, the graph's joint covariances, and the conclusions of section 3.3 of
J. Zheng et al., Micromachines 12 (2021) 1527, on logs made for each of them.

Made logs are free of errors: covariances depend on where the problem is linearised, not on the errors drawn, and so
every figure here follows from the declared sigmas and the motion alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from engine_logs import MEMS, SHORT, TWO_CUTS, simulated, smoothed, until
from scipy.spatial.transform import Rotation

from graphnav import log as gl
from graphnav._directions import weak_directions
from graphnav._stages import Stages
from graphnav.config import Config
from graphnav.errors import GraphnavError
from graphnav.graph import build_graph
from graphnav.observability import FACE_STATES, STATES, Observability, analyse, of_covariances, of_filter, of_graph
from graphnav.problem import B, C, V, X
from graphnav.report.observability import plot, render
from graphnav.report.text import to_json
from graphnav.rounds import Solved
from graphnav.run import DEG_H, DEGREE, MG
from graphnav.simulation.motion import Motion
from graphnav.simulation.sensors import earth_rate_n, inertial_samples
from graphnav.smooth import posed
from graphnav.solution import solve_batch
from graphnav.solvers.joint_states import graph_covariances

GRAVITY = 9.7973
IMU = {
    "gyro_bias_deg_h": 720.0,
    "gyro_random_walk_deg_sqrt_h": 0.6,
    "accel_bias_mg": 3.0,
    "accel_random_walk_mg_sqrt_hz": 0.08,
}
SLIP, PUSH_SIGMA, START_SIGMA, SURVEY_SIGMA = 0.01, 0.03, 0.05, 0.02
GYRO_WALK = np.radians(0.6) / 60  # rad / sqrt(s)
MOUNTING = ("mounting angle about right", "mounting angle about up")
HORIZONTAL = ("accelerometer bias right", "accelerometer bias forward")


# Logs made for one question ---------------------------------------------------------------------------------


def steady(t: np.ndarray) -> np.ndarray:
    return np.full_like(t, 0.3)


def varying(t: np.ndarray) -> np.ndarray:
    """Accelerations, but never at rest."""
    return 0.3 + 0.2 * np.sin(2 * np.pi * t / 20)


def stopping(t: np.ndarray) -> np.ndarray:
    """10 s at rest, 26 s of travel, again and again."""
    return np.clip(0.1 * np.minimum(t % 40 - 10, 36 - t % 40), 0, 0.3)


def straight(t: np.ndarray) -> np.ndarray:
    """To the north: the body's axes are those of n."""
    return np.zeros_like(t)


def bent(t: np.ndarray) -> np.ndarray:
    """A quarter turn at half time."""
    return np.pi / 2 * np.clip((t - 55) / 15, 0, 1)


Profile = Callable[[np.ndarray], np.ndarray]


def travelling(speed: Profile, heading: Profile = straight, positions: bool = False) -> gl.SensorLog:
    """Two minutes on a level floor, the start's velocity unknown to 1 m/s; positions in n to 3 cm each second."""
    t = np.arange(12_001) / 100
    v, yaw = speed(t), heading(t)
    vel_n = v[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)])
    pos_n = np.vstack([np.zeros(3), np.cumsum((vel_n[1:] + vel_n[:-1]) / 200, axis=0)])
    rot_nb = Rotation.from_euler("Z", yaw[:, None])
    gyro, accel = inertial_samples(Motion(pos_n, vel_n, v, rot_nb), rot_nb, 0.01, earth_rate_n(35.0), GRAVITY)
    fixes = slice(100, None, 100)
    return gl.SensorLog(
        name="made",
        frames=gl.Frames(35.0, gravity_m_s2=GRAVITY),
        initial=gl.InitialState(
            pos_n_m=pos_n[0],
            pos_sigma_m=[START_SIGMA] * 3,
            quat_nb_wxyz=rot_nb[0].as_quat(scalar_first=True),
            att_sigma_deg=[0.3, 0.3, 1.0],
            vel_n_m_s=vel_n[0],
            vel_sigma_m_s=[1.0, 1.0, 1.0],
        ),
        imu=gl.Imu(t[1:], gyro, accel, **IMU),
        odometer=gl.Odometer(
            t[10::10],
            v[10::10],
            sigma_m_s=0.01,
            slip_sigma_m_s=SLIP,
            scale_sigma=0.05,
            mounting_sigma_deg=[3.0, 0.5, 3.0],
        ),
        position=gl.Position(t[fixes], pos_n[fixes], np.full((120, 3), 0.03)) if positions else None,
    )


def solved(log: gl.SensorLog, config: Config | None = None) -> tuple[object, Solved]:
    problem = posed(log, config or Config(), Stages(None))
    return problem, solve_batch(problem, Stages(None))


def observed(log: gl.SensorLog, config: Config | None = None, causal: bool = True) -> Observability:
    problem, result = solved(log, config)
    return of_graph(problem, result.data, result.result.values, causal=causal)


@cache
def of_travel(speed: Profile, heading: Profile = straight, positions: bool = False) -> Observability:
    return observed(travelling(speed, heading, positions))


@cache
def of_cuts(closed_path: bool, survey: bool) -> Observability:
    """Two cuts of 20 m, 3 cm of push, 1 deg of heading."""
    log = simulated(TWO_CUTS, noise=False)
    log = log if survey else dataclasses.replace(log, surveyed=())
    return observed(log, Config.from_dict({"closed_path": {"form": "relative" if closed_path else "off"}}))


def index(o: Observability, name: str) -> int:
    return [state.name for state in o.states].index(name)


def final(o: Observability, *names: str) -> np.ndarray:
    """Ratios at the end."""
    return o.ratio[-1, [index(o, name) for name in names]]


# Section 3.3.1: velocity ------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [steady, varying, stopping])
@pytest.mark.parametrize("positions", [False, True])
def test_velocity_is_observable(speed: Profile, positions: bool) -> None:
    o = of_travel(speed, positions=positions)
    # the odometer's constraints hold it to centimetres per second, 1 m/s was declared
    assert (o.ratio[-1, :3] < 0.2).all()


@pytest.mark.parametrize(("speed", "heading"), [(steady, straight), (varying, straight), (stopping, bent)])
@pytest.mark.parametrize("positions", [False, True])
def test_mounting_angle_about_forward_is_never_observable(speed: Profile, heading: Profile, positions: bool) -> None:
    """The machine does not move across its axis, so a turn about that axis changes nothing measured."""
    o = of_travel(speed, heading, positions)
    assert final(o, "mounting angle about forward")[0] > 0.999
    assert o.undetermined[0].text == "mounting angle about forward +0.50 deg"


@pytest.mark.parametrize("closed_path", [False, True])
@pytest.mark.parametrize("survey", [False, True])
def test_mounting_angle_about_forward_is_not_observable_in_cuts(closed_path: bool, survey: bool) -> None:
    """Not exactly nothing: 11 pushes of 0.4 m to the machine's right are matched to 3 cm, and a wobbling machine's
    slip is not that of a turned one (about one sigma of information per radian, second and axis of wobble).
    """
    o = of_cuts(closed_path, survey)
    alpha, moving_s = np.radians(0.5), 250
    information = 2 * moving_s + closed_path * 11 * (0.4 / PUSH_SIGMA) ** 2
    assert 1 / np.sqrt(1 + alpha**2 * information) < final(o, "mounting angle about forward")[0] < 1.0001
    assert o.verdicts[index(o, "mounting angle about forward")] == "not observable"


def test_scale_and_mounting_stay_unknown_at_constant_velocity() -> None:
    """A wrong scale or mounting angle is a wrong velocity, which nothing else knows."""
    o = of_travel(steady)
    assert (final(o, *MOUNTING, "odometer scale") > 0.999).all()
    unknown = {state.name for direction in o.undetermined for state in direction.states}
    assert {*MOUNTING, "odometer scale"} < unknown


@pytest.mark.parametrize("speed", [varying, stopping])
def test_scale_and_mounting_about_right_and_up_need_accelerations(speed: Profile) -> None:
    """The accelerometers feel the direction and size of a change of speed in the body frame.

    Over 3 s of a start to 0.3 m/s they drift by 0.08 mg/sqrt(Hz) sqrt(3 s) = 1.4 mm/s: 0.26 deg at best.
    """
    o = of_travel(speed)
    assert (final(o, *MOUNTING, "odometer scale") < 1 / 3).all()
    assert (final(o, *MOUNTING) > 0.26 / 3 / np.sqrt(12)).all()  # there are at most 12 changes of speed
    assert not {*MOUNTING, "odometer scale"} & {s.name for d in o.undetermined for s in d.states}


@pytest.mark.parametrize("speed", [steady, varying, stopping])
def test_vertical_accelerometer_bias_is_observable_and_horizontal_ones_are_tied_to_tilts(speed: Profile) -> None:
    """At one attitude the accelerometers measure ``b - g phi``: what is left of b is the two priors' combination."""
    o = of_travel(speed)
    assert final(o, "accelerometer bias up")[0] < 0.01
    bias, tilt = 3 * MG, GRAVITY * np.radians(0.3)
    assert final(o, *HORIZONTAL) == pytest.approx(tilt / np.hypot(bias, tilt), abs=0.005)
    assert final(o, "tilt about east", "tilt about north") == pytest.approx(bias / np.hypot(bias, tilt), abs=0.005)
    for names, sign in (
        (("accelerometer bias right", "tilt about north"), 1),
        (("accelerometer bias forward", "tilt about east"), -1),
    ):
        direction = next(d for d in o.weakest[-1] if {*names} <= {s.name for s in d.states})
        amount = dict(zip((s.name for s in direction.states), direction.amounts, strict=True))
        assert amount[names[0]] == pytest.approx(sign * GRAVITY * amount[names[1]], rel=0.02)


@pytest.mark.parametrize("speed", [steady, stopping])
def test_turning_separates_biases_from_tilts(speed: Profile) -> None:
    """A tilt stays in n, a bias turns with the body."""
    ahead, turned = of_travel(speed), of_travel(speed, bent)
    names = (*HORIZONTAL, "tilt about east", "tilt about north")
    assert (final(turned, *names) < 0.4 * final(ahead, *names)).all()
    assert (final(turned, *names) < 1 / 3).all()


def test_position_is_not_observable_from_velocity() -> None:
    """Its sigma starts as declared and grows with the slip, sqrt(seconds) x 1 cm: nothing brings it back."""
    for speed in (steady, varying, stopping):
        o = of_travel(speed)
        sigma = o.sigma[:, 6:9]
        assert sigma[0] == pytest.approx(START_SIGMA, rel=0.01)
        assert (sigma[-1] > START_SIGMA).all()
        moving_s = float(np.sum(speed(np.arange(1200) / 10) > 0)) / 10
        assert (sigma[-1, :2].max()) > np.hypot(START_SIGMA, 0.8 * SLIP * np.sqrt(moving_s))
        assert all(o.verdicts[k] == "not observable" for k in (6, 7, 8))


def test_heading_is_not_observable_from_velocity() -> None:
    """All that an odometer and an IMU measure turns with the heading, but for the Earth's rate: 15 deg/h, a fiftieth
    of this gyro's bias.
    """
    for speed in (steady, varying, stopping):
        assert final(of_travel(speed), "heading")[0] > 0.99


# Section 3.3.2: position ------------------------------------------------------------------------------------


def test_position_is_bounded_by_closed_path() -> None:
    """The second cut ends a push away from the start: neither can be worse than the start's sigma with the push's."""
    push = np.hypot(PUSH_SIGMA, 0.4 * np.radians(1.1))  # the push is laid off along an uncertain axis
    bound = np.hypot(START_SIGMA, push)
    without, with_path = (of_cuts(path, survey=False) for path in (False, True))
    assert (with_path.sigma[-1, 6:9] < bound).all()
    assert (without.sigma[-1, 6:9] > bound).all()
    assert without.sigma[-1, 6] > 2 * bound  # across the face
    # the error of the start itself is common to all, and cannot be seen
    assert (with_path.sigma[-1, 6:9] > START_SIGMA).all()


def test_position_does_not_grow_with_time_on_a_closed_path() -> None:
    """Four cycles: at their end the sigma is the start's with that of three pushes, not that of 17 minutes of slip."""
    log = dataclasses.replace(simulated(MEMS, noise=False), surveyed=())
    push = np.hypot(PUSH_SIGMA, 0.4 * np.radians(1.1))
    forms = [
        observed(log, Config.from_dict({"closed_path": {"form": form}}), causal=False) for form in ("relative", "off")
    ]
    bounded, free = (o.sigma[-1, 6:9] for o in forms)
    assert (bounded < np.hypot(START_SIGMA, np.sqrt(3) * push)).all()
    assert free[0] > 5 * bounded[0]
    assert free[2] > 3 * bounded[2]


def test_position_is_observable_where_it_is_measured() -> None:
    """At most the 3 cm of the last of 120 positions, with the slip since it; here 5 cm were declared."""
    for speed in (steady, varying, stopping):
        assert (of_travel(speed, positions=True).sigma[-1, 6:9] < np.hypot(0.03, SLIP)).all()
        assert (of_travel(speed, positions=True).ratio[-1, 6:9] < of_travel(speed).ratio[-1, 6:9] / 3).all()


def test_heading_improves_with_accelerations_where_positions_are_measured() -> None:
    """At constant velocity positions tell the course alone, heading less mounting angle; accelerations, felt in b
    and seen in n, tell the heading.
    """
    unaccelerated, accelerated = of_travel(steady, positions=True), of_travel(varying, positions=True)
    stops = of_travel(stopping, positions=True)
    course_alone = 3 / np.hypot(1, 3)  # the heading's 1 deg and the mounting's 3 deg share the course
    assert final(unaccelerated, "heading")[0] > course_alone
    shared = unaccelerated.weakest[-1][0]
    assert [s.name for s in shared.states] == ["heading", "mounting angle about up"]
    assert shared.amounts[0] == pytest.approx(shared.amounts[1], rel=0.3)
    assert final(accelerated, "heading")[0] < 0.8 * course_alone
    assert final(stops, "heading")[0] < 0.8 * course_alone


def test_heading_does_not_improve_with_closed_path_alone() -> None:
    """A pass over the last line turns with it: accelerations or not, there is nothing in n to compare with."""
    assert final(of_cuts(closed_path=True, survey=False), "heading")[0] > 0.99


# A surveyed far end -----------------------------------------------------------------------------------------


def course_sigma(o: Observability) -> float:
    """Sigma of the direction of travel: heading less mounting angle about up."""
    row = np.zeros(len(o.states))
    row[[index(o, "heading"), index(o, "mounting angle about up")]] = 1, -1
    return float(np.sqrt(row @ o.covariance[-1] @ row))


@pytest.mark.parametrize("closed_path", [False, True])
def test_a_surveyed_far_end_gives_the_course(closed_path: bool) -> None:
    """20 m between two points known to 5 and 2 cm, slip over 70 s between them, and the gyro over 230 s to the end: its
    noise, and its bias that 30 s at rest gave.
    """
    without, with_survey = (of_cuts(closed_path, survey) for survey in (False, True))
    points = np.hypot(START_SIGMA, SURVEY_SIGMA) / 20
    slip = SLIP * np.sqrt(70) / 20
    carried = GYRO_WALK * np.sqrt(230 + 230**2 / 30)
    assert np.degrees(course_sigma(without)) > 1.0
    assert course_sigma(with_survey) < np.sqrt(points**2 + slip**2 + carried**2) < np.radians(0.6)


@pytest.mark.parametrize("closed_path", [False, True])
def test_a_surveyed_far_end_improves_heading_as_far_as_mounting_is_known(closed_path: bool) -> None:
    without, with_survey = (of_cuts(closed_path, survey) for survey in (False, True))
    mounting = without.sigma[-1, index(without, "mounting angle about up")]
    heading = with_survey.sigma[-1, index(with_survey, "heading")]
    own = np.radians(1.0)
    assert heading < 1.1 * np.sqrt(1 / (1 / own**2 + 1 / (mounting**2 + course_sigma(with_survey) ** 2)))
    assert final(without, "heading")[0] > 0.99


def test_a_surveyed_far_end_bounds_the_positions_between() -> None:
    """Without it the far end is as wide as the heading makes it; with it every cut ends where something is known."""
    log = simulated(TWO_CUTS, noise=False)
    assert log.events is not None
    far = float(log.events.t_s[1])
    apart = []
    for survey in (False, True):
        given = log if survey else dataclasses.replace(log, surveyed=())
        o = observed(given, causal=False)
        apart.append(o.sigma[np.argmin(np.abs(o.t_s - far)), 6])
    assert apart[0] > 0.9 * 20 * np.radians(1.0)
    assert apart[1] < SURVEY_SIGMA * 1.5
    assert any(
        {"position across the face", "heading"} <= {s.name for s in d.states}
        for directions in observed(dataclasses.replace(log, surveyed=()), causal=False).weakest
        for d in directions[:1]
    )


# The graph's joint covariances ------------------------------------------------------------------------------


@cache
def short() -> tuple[object, Solved]:
    return solved(simulated(SHORT))


def test_joint_covariances_are_the_dense_inverse() -> None:
    problem, result = short()
    values, data = result.result.values, result.data
    linear = build_graph(problem, data).linearize(values)
    order = result.result.order
    import gtsam

    ordering = gtsam.Ordering()
    at, rows, size = 0, {}, {"x": 6, "v": 3, "b": 6, "c": 4, "k": 1}
    for key in order:
        ordering.push_back(key)
        rows[key] = np.arange(at, at + size[chr(key >> 56)])
        at += len(rows[key])
    root = np.linalg.inv(np.linalg.qr(linear.jacobian(ordering)[0], mode="r"))
    keyframes = [0, 1, 40, len(problem.keyframe_s) - 1]
    found = graph_covariances(problem, data, values, keyframes)
    for cov, i in zip(found, keyframes, strict=True):
        epoch = max(i - 1, 0)
        own = [X(i), V(i), B(int(problem.bias_epoch[epoch])), C(int(problem.calibration_epoch[epoch]))]
        part = root[np.concatenate([rows[key] for key in own])]
        att, pos, vel, accel, gyro, scale, mount = (
            part[a:b] for a, b in ((0, 3), (3, 6), (6, 9), (9, 12), (12, 15), (15, 16), (16, 19))
        )
        rotation = values.atPose3(X(i)).rotation().matrix()
        in_order = np.vstack([vel, rotation @ att, rotation @ pos, gyro, accel, mount, scale])
        expected = in_order @ in_order.T
        sigma = np.sqrt(np.diag(expected))
        assert np.abs((cov - expected) / np.outer(sigma, sigma)).max() < 1e-5


def test_joint_covariances_agree_with_the_run() -> None:
    """The same sigmas as the trajectory and the calibration table have, in their units."""
    problem, result = short()
    last = len(problem.keyframe_s) - 1
    sigma = np.sqrt(np.diag(graph_covariances(problem, result.data, result.result.values, [last])[0]))
    run = smoothed(SHORT)
    assert run.trajectory.cov is not None
    theirs = np.sqrt(np.diag(run.trajectory.cov[-1]))
    assert sigma[[0, 1, 2, 6, 7, 8]] == pytest.approx(theirs[[6, 7, 8, 3, 4, 5]], rel=1e-3)
    units = [DEG_H] * 3 + [MG] * 3 + [DEGREE] * 3 + [1.0]
    names = [f"gyro_bias_{a}" for a in "xyz"] + [f"accel_bias_{a}" for a in "xyz"]
    names += [f"odometer_mounting_{a}" for a in ("right", "forward", "up")] + ["odometer_scale"]
    assert sigma[9:] / units == pytest.approx([run.calibration[name].sigma for name in names], rel=1e-3)


def test_causal_is_the_log_cut_off_there() -> None:
    """The graph cut off at a keyframe says what a log says that ends there."""
    log = dataclasses.replace(simulated(SHORT, noise=False), events=None, face=None, surveyed=())
    problem, result = solved(log)
    values, data = result.result.values, result.data
    for end_s in (20.0, 45.0):
        i = int(np.argmin(np.abs(problem.keyframe_s - end_s)))
        causal = graph_covariances(problem, data, values, [i], causal=True)[0]
        cut_problem, cut = solved(until(log, float(problem.keyframe_s[i])))
        last = len(cut_problem.keyframe_s) - 1
        expected = graph_covariances(cut_problem, cut.data, cut.result.values, [last])[0]
        assert np.sqrt(np.diag(causal)) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.02)


def test_causal_and_smoothed_meet_at_the_end() -> None:
    problem, result = short()
    last = len(problem.keyframe_s) - 1
    causal, smooth_ = (
        graph_covariances(problem, result.data, result.result.values, [5, last], causal=c) for c in (True, False)
    )
    sigma = np.sqrt(np.diag(smooth_[1]))
    assert np.abs((causal[1] - smooth_[1]) / np.outer(sigma, sigma)).max() < 1e-5
    assert (np.diag(causal[0]) > 0.999 * np.diag(smooth_[0])).all()
    assert np.sqrt(causal[0][18, 18]) == pytest.approx(0.05, rel=1e-3)  # at rest nothing is learnt of the scale


def test_a_log_without_an_odometer_has_fifteen_states() -> None:
    log = dataclasses.replace(travelling(varying, positions=True), odometer=None)
    o = observed(log)
    assert o.states == STATES[:15]
    assert o.covariance.shape[1:] == (15, 15)
    assert len(o.information) == 6


def test_a_longwall_log_is_told_along_its_face() -> None:
    assert of_cuts(closed_path=True, survey=False).states == FACE_STATES
    assert of_travel(steady).states == STATES


@pytest.mark.parametrize("forward", [True, False])
def test_what_moves_is_turned_to_the_face(forward: bool) -> None:
    """Covariances from elsewhere, a filter's say: to the right of the first cut and along it, towards the far end."""
    problem, result = solved(simulated(TWO_CUTS, noise=False))
    pos_n = np.array([result.result.values.atPose3(X(i)).translation() for i in range(len(problem.keyframe_s))])
    if not forward:  # the first cut comes from the far end
        pos_n = -pos_n
        cycles = tuple(dataclasses.replace(c, forward=not c.forward) for c in problem.frontend.cycles)
        problem = dataclasses.replace(problem, frontend=dataclasses.replace(problem.frontend, cycles=cycles))
    heading = np.radians(17.0)
    right, along = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    for at, name in ((0, "velocity"), (3, "tilt"), (6, "position")):
        error = np.zeros(19)
        error[at : at + 2], error[18] = 2 * right + 3 * along, 1.0
        cov = np.outer(error, error) + 1e-6 * np.eye(19)
        found = of_covariances(problem, np.array([9.0]), cov[None], pos_n, "causal").covariance[0]
        # the cut bends by 3 cm on 20 m
        assert found[at : at + 2, 18] == pytest.approx([2, 3], abs=0.03), name
        assert found[18, 18] == pytest.approx(1)


def test_a_filter_says_the_same_as_the_graph_cut_off() -> None:
    """Two computations with little in common, on an exact log. What they differ in is linearisation, the odometer taken
    sample by sample or over a second (velocity is left out for that), and, in the first seconds, how rest is told.
    """
    from graphnav.baselines.inputs import PRESETS
    from graphnav.baselines.rts import filtered
    from graphnav.filtered import as_inputs

    problem, result = solved(dataclasses.replace(simulated(SHORT, noise=False), face=None))
    estimates, _ = filtered(as_inputs(problem), PRESETS["matched"], None)
    by_filter = of_filter(problem, estimates)
    by_graph = of_graph(problem, result.data, result.result.values, causal=True, count=20)
    assert by_filter.kind == by_graph.kind == "causal"
    settled = by_graph.t_s > 10
    assert settled.sum() >= 8
    for t, sigma in zip(by_graph.t_s[settled], by_graph.sigma[settled], strict=True):
        k = int(np.argmin(np.abs(by_filter.t_s - t)))
        assert by_filter.sigma[k, 3:] == pytest.approx(sigma[3:], rel=0.1), t
    assert by_filter.verdicts == by_graph.verdicts


# The analysis alone -----------------------------------------------------------------------------------------

REFERENCE = np.array(
    [1.0] * 3 + [0.005] * 2 + [0.02] + [0.05] * 3 + [3.5e-3] * 3 + [0.03] * 3 + [0.05, 0.01, 0.05, 0.05]
)


def known(*combinations: tuple[dict[str, float], float]) -> np.ndarray:
    """The covariance when combinations of scaled states are measured, each to a share of its prior."""
    information = np.eye(19)
    names = [state.name for state in STATES]
    for parts, share in combinations:
        row = np.zeros(19)
        for name, weight in parts.items():
            row[names.index(name)] = weight
        information += np.outer(row, row) / (share**2 * (row @ row))
    return np.linalg.inv(information) * np.outer(REFERENCE, REFERENCE)


def test_nothing_learnt_is_nothing_observable() -> None:
    o = analyse(np.array([3.0]), np.diag(REFERENCE**2)[None], REFERENCE)
    assert set(o.verdicts) == {"not observable"}
    assert np.isnan(o.since_s).all()
    assert np.abs(o.information).max() < 1e-9
    assert len(o.weakest[0]) == 19
    assert all(len(d.states) == 1 and d.size == pytest.approx(1) for d in o.weakest[0])


def test_verdicts_follow_the_ratio() -> None:
    scale = np.full(19, 0.99)
    scale[:5] = 0.3, 0.34, 0.94, 0.96, 5.0
    o = analyse(np.array([0.0]), np.diag((scale * REFERENCE) ** 2)[None], REFERENCE)
    assert o.verdicts[:5] == ("observable", "improved", "improved", "not observable", "not observable")


@pytest.mark.parametrize("seed", range(5))
def test_tied_states_are_named_together_whatever_the_basis(seed: int) -> None:
    """Six measured combinations leave several directions with equal eigenvalues; their names do not depend on luck."""
    tied = [
        ({"accelerometer bias right": 1.0, "tilt about north": -1.0}, 1e-3),
        ({"accelerometer bias forward": 1.0, "tilt about east": 1.0}, 1e-3),
        ({"heading": 1.0, "mounting angle about up": 1.5}, 1e-2),
    ]
    alone = [({state.name: 1.0}, 1e-3) for state in STATES if "velocity" in state.name or "position" in state.name]
    cov = known(*tied, *alone)
    rng = np.random.default_rng(seed)
    noise = 1 + 1e-9 * rng.normal(size=(19, 19))
    found = weak_directions(cov * noise, REFERENCE, STATES)
    assert {frozenset(s.name for s in d.states) for d in found} == {
        *(frozenset(parts) for parts, _ in tied),
        *(frozenset([f"gyro bias {axis}"]) for axis in ("right", "forward", "up")),
        *(
            frozenset([name])
            for name in ("accelerometer bias up", *(f"mounting angle about {a}" for a in ("right", "forward")))
        ),
        frozenset(["odometer scale"]),
    }
    pairs = {d.states[0].name: d for d in found if len(d.states) == 2}
    assert all(d.size == pytest.approx(1, abs=1e-3) for d in found)
    against = next(d for d in pairs.values() if {"tilt about east"} & {s.name for s in d.states})
    assert against.amounts[0] > 0 > against.amounts[1]


def test_weak_directions_hold_all_error_of_their_subspace() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(19, 19)) * 10.0 ** rng.uniform(-2, 1, 19)
    scaled = root @ root.T
    found = weak_directions(scaled * np.outer(REFERENCE, REFERENCE), REFERENCE, STATES)
    eigenvalues = np.linalg.eigvalsh(scaled)
    assert sum(d.size**2 for d in found) == pytest.approx(eigenvalues[eigenvalues > 0.5].sum())
    assert [d.size for d in found] == sorted((d.size for d in found), reverse=True)


def test_a_direction_that_explains_a_known_state_names_what_is_lost() -> None:
    """Position across the face is twenty times its start, all of it by the heading, which is as it was declared."""
    cov = np.diag(REFERENCE**2)
    lever = 20 * REFERENCE[6] / REFERENCE[5]
    cov[6, 6] = (lever * REFERENCE[5]) ** 2 + REFERENCE[6] ** 2
    cov[5, 6] = cov[6, 5] = -lever * REFERENCE[5] ** 2
    weakest = weak_directions(cov, REFERENCE, FACE_STATES)[0]
    assert [s.name for s in weakest.states] == ["position across the face", "heading"]
    assert weakest.size == pytest.approx(20, rel=0.01)
    assert weakest.text == "position across the face +1.0 m with heading -1.1 deg"


def test_every_cause_of_a_large_error_names_it() -> None:
    """Position across the face has two causes: each direction says how much of it comes with which."""
    causes = {"heading": 20.0, "mounting angle about up": 40.0}
    names = [state.name for state in FACE_STATES]
    mixed = np.diag(np.where(np.isin(names, list(causes)), 1.0, 0.1))
    for cause, lever in causes.items():
        mixed[6, names.index(cause)] = lever
    cov = mixed @ mixed.T * np.outer(REFERENCE, REFERENCE)
    found = weak_directions(cov, REFERENCE, FACE_STATES)
    assert [[s.name for s in d.states] for d in found] == [
        ["position across the face", "mounting angle about up"],
        ["position across the face", "heading"],
    ]
    assert np.linalg.norm([d.size for d in found]) == pytest.approx(np.hypot(40, 20), rel=0.01)


def test_what_is_known_in_a_sum_alone_is_named_with_its_partner() -> None:
    """Ten times better known than before, and all that is left of it is the other's."""
    alone = [({state.name: 1.0}, 1e-3) for state in STATES if state.name not in ("heading", "odometer scale")]
    cov = known(({"heading": 1.0, "odometer scale": 0.1}, 1e-3), *alone)
    (found,) = weak_directions(cov, REFERENCE, STATES)
    amount = dict(zip((s.name for s in found.states), found.amounts, strict=True))
    assert set(amount) == {"heading", "odometer scale"}
    assert amount["heading"] / REFERENCE[5] == pytest.approx(-0.1 * amount["odometer scale"] / REFERENCE[18], rel=0.01)


def test_information_is_that_of_the_data_alone() -> None:
    """Eigenvalues of ``D (P^-1 - D^-2) D`` of the ten states that do not move."""
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(6, 10)) * 10.0 ** rng.uniform(-1, 2, (6, 1))
    gained = rows.T @ rows
    cov = np.diag(REFERENCE**2)
    cov[9:, 9:] = np.linalg.inv(np.eye(10) + gained) * np.outer(REFERENCE[9:], REFERENCE[9:])
    o = analyse(np.array([0.0]), cov[None], REFERENCE)
    expected = np.linalg.eigvalsh(gained)
    assert o.information == pytest.approx(np.maximum(expected, 0), rel=1e-6, abs=1e-9 * expected.max())
    assert len(o.undetermined) == (expected < 1).sum()


def test_since_is_the_start_of_the_last_observable_stretch() -> None:
    t = np.arange(6.0)
    ratio = np.ones((6, 19))
    ratio[:, 0] = 1, 0.1, 1, 0.2, 0.1, 0.1
    ratio[:, 1] = 0.1
    ratio[:, 2] = 0.1, 0.1, 0.1, 0.1, 0.1, 1
    o = analyse(t, np.array([np.diag((row * REFERENCE) ** 2) for row in ratio]), REFERENCE)
    assert o.since_s[:2].tolist() == [3.0, 0.0]
    assert np.isnan(o.since_s[2:]).all()


def test_spans_of_the_weakest_direction() -> None:
    t = np.arange(5.0)
    ratio = np.full((5, 19), 0.1)
    ratio[:, 5] = 1.0, 1.0, 1.0, 1.0, 0.1
    ratio[:, 6] = 0.1, 0.1, 2.0, 3.0, 0.1
    o = analyse(t, np.array([np.diag((row * REFERENCE) ** 2) for row in ratio]), REFERENCE)
    spans = [(a, b, d.text) for a, b, d in o.weakest_spans()]
    assert spans == [(0.0, 1.0, "heading +1.1 deg"), (2.0, 3.0, "position east +0.15 m")]
    assert o.weakest[-1] == ()


@pytest.mark.parametrize(
    ("t_s", "covariance", "reference"),
    [
        (np.zeros(0), np.zeros((0, 19, 19)), REFERENCE),
        (np.zeros(1), np.eye(19)[None, :18, :18], REFERENCE),
        (np.zeros(1), np.zeros((1, 19, 19)), REFERENCE),
        (np.zeros(1), np.eye(19)[None], np.zeros(19)),
    ],
)
def test_what_cannot_be_analysed_is_refused(t_s: np.ndarray, covariance: np.ndarray, reference: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"shape|above zero"):
        analyse(t_s, covariance, reference)


# Report -----------------------------------------------------------------------------------------------------


def test_dict_is_strict_json_and_complete() -> None:
    o = of_cuts(closed_path=True, survey=False)
    known_ = o.to_dict()
    to_json(known_)
    rows = {row["state"]: row for row in known_["states"]}
    assert rows["odometer scale"]["reference"] == pytest.approx(5.0, rel=1e-3)
    scale = rows["odometer scale"]
    assert scale["ratio"] == pytest.approx(scale["sigma"] / scale["reference"], rel=1e-12)
    assert rows["heading"]["verdict"] == "not observable"
    assert known_["calibration"]["directions"] == 10
    assert known_["calibration"]["determined"] == 9
    assert len(known_["ratio"]) == len(known_["t_s"])


def test_render_says_what_is_weak(capsys: pytest.CaptureFixture[str]) -> None:
    for o in (of_cuts(closed_path=True, survey=False), observed(simulated(SHORT), causal=False)):
        render(o)
        out, err = capsys.readouterr()
        assert out == ""
        for state in o.states:
            assert state.name in err
        assert o.weakest[-1][0].text in err
        assert "nan" not in err


def test_plot_is_written(tmp_path) -> None:
    o = of_cuts(closed_path=True, survey=False)
    path = plot(o, tmp_path / "observability.png")
    assert path.read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(GraphnavError, match="picture's name"):
        plot(o, tmp_path / "observability.txt")
