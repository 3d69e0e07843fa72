"""Ranges of a log as epochs, the side of the anchors' plane, and the position at the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from uwb_logs import ANCHORS, LEVER, Errors, passing

from graphnav.errors import LogError
from graphnav.frontends.range_epochs import is_unknown, positions, range_epochs, start_position, total_sigma
from graphnav.log import SensorLog, UwbAnchor

UNDERGROUND = np.array([(1.251, 3.352, -0.251), (0.0, 0.0, 0.0), (-0.110, 2.375, 0.311), (-1.223, 2.758, 0.349)])
PLANE = np.array([(0.0, 0.0, 1.0), (4.0, 0.0, 1.0), (0.0, 3.0, 1.0), (4.0, 3.0, 1.0)])
EXACT = Errors(white_m=1e-6)


def true_tag(log: SensorLog, t_s: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t_s, log.truth.t_s, column) for column in log.truth.pos_n_m.T]) + LEVER


def with_anchors(log: SensorLog, count: int) -> SensorLog:
    wanted = np.isin(log.uwb.anchor_id, [a.id for a in log.uwb.anchor[:count]])
    rows = {name: getattr(log.uwb, name)[wanted] for name in ("t_s", "tag_id", "anchor_id", "range_m")}
    return replace(log, uwb=replace(log.uwb, anchor=log.uwb.anchor[:count], **rows))


def test_epochs_hold_each_anchor_once() -> None:
    log = passing(seconds=12.0)
    epochs = range_epochs(log)
    assert len(epochs.t_s) == len(log.uwb) // 4
    assert np.isfinite(epochs.ranges_m).all()
    assert epochs.t_s[:2] == pytest.approx([0.05, 0.15])
    assert (epochs.lever_arm_b == LEVER).all()


def test_a_lost_range_costs_no_other() -> None:
    log = passing(seconds=12.0)
    keep = np.arange(len(log.uwb)) != 6
    rows = {name: getattr(log.uwb, name)[keep] for name in ("t_s", "tag_id", "anchor_id", "range_m")}
    epochs = range_epochs(replace(log, uwb=replace(log.uwb, **rows)))
    assert np.isfinite(epochs.ranges_m).sum() == len(log.uwb) - 1
    assert np.isnan(epochs.ranges_m[1]).tolist() == [False, False, True, False]


def test_slow_radios_have_longer_epochs() -> None:
    log = passing(seconds=12.0)
    slow = replace(log, uwb=replace(log.uwb, t_s=log.uwb.t_s * 10))
    assert np.isfinite(range_epochs(slow).ranges_m).all()
    with pytest.raises(LogError, match="no three anchors answer together"):
        range_epochs(slow, span_s=0.1)


def test_two_tags_have_epochs_of_their_own() -> None:
    log = passing(seconds=12.0)
    other = np.where(np.arange(len(log.uwb)) // 4 % 2, "2", "1").astype(object)
    tags = (log.uwb.tag[0], replace(log.uwb.tag[0], id="2", lever_arm_b_m=np.zeros(3)))
    epochs = range_epochs(replace(log, uwb=replace(log.uwb, tag_id=other, tag=tags)))
    assert (np.diff(epochs.t_s) > 0).all()
    assert epochs.lever_arm_b[:4, 2] == pytest.approx([-0.3, 0.0, -0.3, 0.0])


def test_nearly_exact_ranges_give_the_path() -> None:
    log = passing(errors=EXACT, seconds=20.0)
    epochs = range_epochs(log)
    # within an epoch the machine moves 5 mm
    assert positions(epochs).pos_n == pytest.approx(true_tag(log, epochs.t_s), abs=0.03)


def test_all_epochs_are_on_the_side_that_they_vote_for() -> None:
    """Anchors nearly in a plane: half of the epochs by themselves say the wrong side."""
    noisy = Errors(white_m=0.03)
    log = passing(2, noisy, anchors=UNDERGROUND, tag_start=(0.5, -1.0, 1.0), seconds=40.0)
    epochs = range_epochs(log)
    found, true = positions(epochs), true_tag(log, epochs.t_s)
    normal = np.linalg.svd(UNDERGROUND - UNDERGROUND.mean(axis=0))[2][2]
    side = np.sign((found.pos_n - UNDERGROUND.mean(axis=0)) @ normal)
    height = (true - UNDERGROUND.mean(axis=0)) @ normal
    clear = np.abs(height) > 0.5
    assert clear.sum() > 50
    assert (side == np.sign(height))[clear].mean() > 0.97


def test_the_start_is_as_sure_as_it_says() -> None:
    """NEES of 40 drawn starts, each with constants and Markov errors: chi-square of 120, false alarm 1 in 1000."""
    total = 0.0
    for seed in range(40):
        log = passing(seed, Errors(0.013, 0.01, 2.0, 0.003), seconds=12.0, known=False)
        pos, cov = start_position(log, np.eye(3), 0.0, np.array([[0.0, 10.0]]))
        error = pos - log.truth.pos_n_m[0]
        total += error @ np.linalg.solve(cov, error)
    assert 76.0 < total < 177.0


def test_multipath_at_rest_is_held_off() -> None:
    log = passing(3, Errors(0.013, multipath=0.05), seconds=12.0, known=False)
    assert is_unknown(log.initial)
    pos, _ = start_position(log, np.eye(3), 0.0, np.array([[0.0, 10.0]]))
    assert np.abs(pos - log.truth.pos_n_m[0]).max() < 0.04


def test_a_start_without_rest() -> None:
    log = passing(3, EXACT, rest_s=0.0, seconds=12.0)
    pos, cov = start_position(log, np.eye(3), 0.0, np.zeros((0, 2)))
    assert pos == pytest.approx(log.truth.pos_n_m[0], abs=0.02)
    assert np.isfinite(cov).all()


def test_sigma_of_a_range_has_all_its_parts() -> None:
    uwb = passing(errors=Errors(0.03, 0.04, 2.0, 0.12), seconds=12.0).uwb
    assert total_sigma(uwb) == pytest.approx(np.full(4, 0.13))


# Refusals ---------------------------------------------------------------------------------------------------


def test_too_few_anchors() -> None:
    with pytest.raises(LogError, match="table uwb, anchor: 2 anchors, a position from ranges alone needs 3"):
        range_epochs(with_anchors(passing(seconds=12.0), 2))


def test_anchors_on_a_line() -> None:
    log = passing(seconds=12.0, anchors=np.outer(np.arange(4.0), [1.0, 2.0, 0.5]) + 1.0)
    with pytest.raises(LogError, match="the anchors lie on one line"):
        range_epochs(log)


def test_anchors_in_a_plane_need_a_position() -> None:
    log = passing(errors=EXACT, seconds=12.0, anchors=PLANE)
    with pytest.raises(LogError, match="two mirrored positions have the same ranges; give pos_n_m in"):
        positions(range_epochs(log))
    near = log.truth.pos_n_m[0] + LEVER
    assert np.abs(positions(range_epochs(log), near).pos_n[0] - near).max() < 0.02


def test_no_ranges() -> None:
    with pytest.raises(LogError, match="log passing: no uwb table"):
        range_epochs(replace(passing(seconds=12.0), uwb=None))


def test_an_anchor_that_never_answers_takes_no_part() -> None:
    log = passing(seconds=12.0)
    moved = replace(log, uwb=replace(log.uwb, anchor=(*log.uwb.anchor, UwbAnchor("9", ANCHORS[0] + 1.0, 0.1))))
    epochs = range_epochs(moved)
    assert epochs.anchor_ids == ("1", "2", "3", "4", "9")
    assert np.isnan(epochs.ranges_m[:, 4]).all()
