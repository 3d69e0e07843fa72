"""Contiguous IMU samples: holes found, bridged, refused."""

from __future__ import annotations

import numpy as np
import pytest
from engine_logs import imu_of
from hypothesis import given
from hypothesis import strategies as st

from graphnav.errors import LogError
from graphnav.frontends.imu_samples import imu_samples

REGULAR = np.arange(1, 101) / 100


def values(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.normal(0, 0.1, (count, 3)), rng.normal([0, 0, 9.8], 0.2, (count, 3))


def test_a_gapless_record_is_taken_as_it_is() -> None:
    gyro, accel = values(100)
    found = imu_samples(imu_of(REGULAR, gyro, accel), 0.5)
    assert np.allclose(found.samples.edge_s, np.arange(101) / 100)
    assert np.shares_memory(found.samples.gyro_b, gyro)  # 2.6 million rows are not copied
    assert np.array_equal(found.samples.accel_b, accel)
    assert found.bridged_s.shape == (0, 2)


def test_a_hole_is_one_sample_with_the_mean_of_its_neighbours() -> None:
    gyro, accel = values(100)
    keep = np.r_[0:40, 55:80, 81:100]  # 15 samples and 1 sample missing
    found = imu_samples(imu_of(REGULAR[keep], gyro[keep], accel[keep]), 0.5)
    edge = found.samples.edge_s
    assert len(edge) == len(keep) + 2 + 1
    assert np.allclose(found.bridged_s, [[0.40, 0.55], [0.80, 0.81]])
    assert np.allclose(edge[40:42], [0.40, 0.55])
    assert np.allclose(found.samples.gyro_b[40], (gyro[39] + gyro[55]) / 2)
    assert np.allclose(found.samples.accel_b[40], (accel[39] + accel[55]) / 2)
    # every measured sample is still there, over its own interval
    for row, t in zip(keep, REGULAR[keep], strict=True):
        k = int(np.argmin(np.abs(edge[1:] - t)))
        assert np.array_equal(found.samples.gyro_b[k], gyro[row])
        assert edge[k + 1] - edge[k] == pytest.approx(0.01)


def test_a_hole_that_is_too_long_is_named() -> None:
    keep = (REGULAR <= 0.401) | (REGULAR > 0.901)
    with pytest.raises(LogError) as caught:
        imu_samples(imu_of(REGULAR[keep]), 0.45)
    text = str(caught.value)
    assert "no samples for 0.500 s after t = 0.400 s" in text
    assert "row 41, t_s" in text  # the first row after it, counted from 1
    assert "bridged are at most 0.45 s" in text
    assert "smooth the parts" in text
    assert len(imu_samples(imu_of(REGULAR[keep]), 0.5).bridged_s) == 1  # no longer than what is bridged


def test_the_longest_of_several_holes_is_named() -> None:
    t = np.arange(1, 1001) / 100
    keep = ~(((t > 2) & (t <= 3)) | ((t > 5) & (t <= 8)) | ((t > 9) & (t <= 9.9)))
    with pytest.raises(LogError, match=r"no samples for 3\.000 s after t = 5\.000 s"):
        imu_samples(imu_of(t[keep]), 0.5)


def test_irregular_sampling_is_no_hole() -> None:
    rng = np.random.default_rng(2)
    t = REGULAR + rng.uniform(-0.002, 0.002, 100)
    found = imu_samples(imu_of(t), 0.5)
    assert len(found.bridged_s) == 0
    assert np.allclose(found.samples.edge_s[1:], t)
    assert np.diff(found.samples.edge_s).min() > 0


@given(st.sets(st.integers(1, 98), max_size=40))
def test_samples_are_contiguous_whatever_is_missing(missing: set[int]) -> None:
    keep = np.array([k for k in range(100) if k not in missing])
    found = imu_samples(imu_of(REGULAR[keep]), 10.0)
    edge = found.samples.edge_s
    assert (np.diff(edge) > 1e-6).all()
    assert edge[-1] == REGULAR[-1]
    assert len(edge) == len(found.samples.gyro_b) + 1 == len(found.samples.accel_b) + 1
    lengths = np.diff(found.bridged_s, axis=1)[:, 0]
    assert (lengths > 0).all()
    # measured time and bridged time are all there is
    assert lengths.sum() + 0.01 * len(keep) == pytest.approx(edge[-1] - edge[0], abs=0.011 * len(lengths) + 1e-9)


def test_spread_is_the_signals_own() -> None:
    rng = np.random.default_rng(3)
    gyro, accel = rng.normal(0.5, 0.2, (5000, 3)), rng.normal(9, 1.5, (5000, 3))
    found = imu_samples(imu_of(np.arange(1, 5001) / 100, gyro, accel), 0.5)
    assert found.gyro_spread == pytest.approx(0.2, rel=0.05)
    assert found.accel_spread == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize(
    ("start_s", "end_s"), [(0.0, 1.0), (0.2, 0.5), (0.205, 0.4951), (0.99, 1.0), (0.5, 0.5 + 1e-7)]
)
def test_a_block_covers_its_span_with_a_neighbour_on_either_side(start_s: float, end_s: float) -> None:
    gyro, accel = values(100)
    found = imu_samples(imu_of(REGULAR, gyro, accel), 0.5)
    block = found.samples.block(start_s, end_s)
    assert block.edge_s[0] <= start_s + 1e-6
    assert block.edge_s[-1] >= end_s - 1e-6
    if start_s > 0.01:
        assert block.edge_s[1] <= start_s + 1e-6
    if end_s < 0.99:
        assert block.edge_s[-2] >= end_s - 1e-6
    first = int(np.argmin(np.abs(found.samples.edge_s - block.edge_s[0])))
    assert np.array_equal(block.gyro_b, gyro[first : first + len(block.gyro_b)])
