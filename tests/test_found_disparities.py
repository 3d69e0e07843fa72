"""Disparities of features found in a rendered drive, against the walls."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

import graphnav as gn
from benchmarks.disparity import off_px, slope_along_tracks
from graphnav.config import StereoTracksConfig
from graphnav.frontends.stereo_tracks import tracked
from graphnav.simulation.stereo_images import render_into

SCENARIO, SEED, OPTIONS = "roadheader-stereo", 0, {"rate_hz": 2.0}


@pytest.mark.slow
def test_their_common_error_is_as_small_as_declared(tmp_path: Path) -> None:
    """Within three sigmas, for a fixed seed; the graph holds all disparities of a drive to `bias_px`."""
    gn.write(
        gn.simulate(SCENARIO, SEED, **OPTIONS), tmp_path / "log", images=partial(render_into, SCENARIO, SEED, OPTIONS)
    )
    log = gn.read(tmp_path / "log")
    error, true = off_px(log, tracked(log).tracks, SEED)
    near = np.abs(error) < 0.5
    assert near.mean() > 0.95
    assert ((true > 2) & (true < 30)).mean() > 0.99
    assert abs(error[near].mean()) < 3 * StereoTracksConfig().bias_px


def test_slope_along_tracks() -> None:
    """Whatever each track is off by, and however far its disparity reaches."""
    rng = np.random.default_rng(5)
    track = np.repeat(rng.permutation(40), rng.integers(2, 30, 40))
    true = rng.uniform(2, 20, 40)[track] + rng.uniform(0, 3, len(track))
    error = rng.normal(0, 0.2, 40)[track] - 0.01 * true
    assert slope_along_tracks(track, error, true) == pytest.approx(-0.01, abs=1e-12)
