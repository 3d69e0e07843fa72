"""Normal gravity against published values, Earth rate against its definition."""

from __future__ import annotations

import numpy as np
import pytest

from factors.earth import EARTH_RATE_RAD_S, earth_rate_n, normal_gravity


@pytest.mark.parametrize(
    ("latitude_deg", "gravity"),
    # WGS-84 (NIMA TR8350.2): equator 9.7803253359, pole 9.8321849378; 45 deg from the closed form of GRS 80 tables.
    [(0.0, 9.7803253359), (45.0, 9.8061977694), (90.0, 9.8321849378)],
)
def test_gravity_on_the_ellipsoid(latitude_deg: float, gravity: float) -> None:
    assert normal_gravity(latitude_deg) == pytest.approx(gravity, abs=2e-7)
    assert normal_gravity(-latitude_deg) == normal_gravity(latitude_deg)


def test_gravity_falls_with_height_as_free_air() -> None:
    """0.3086 mGal per metre at mid-latitudes, with the second-order term 3 g (h/a)^2 = 7.2e-7 m/s^2 at 1 km."""
    assert (normal_gravity(45.0, 1.0) - normal_gravity(45.0)) == pytest.approx(-3.086e-6, rel=1e-3)
    up, down = normal_gravity(45.0, 1000.0), normal_gravity(45.0, -1000.0)
    assert up - normal_gravity(45.0) == pytest.approx(-3.0850e-3, abs=1e-6)
    assert (up + down) / 2 - normal_gravity(45.0) == pytest.approx(7.23e-7, rel=1e-2)


def test_scenarios_gravity_is_close_to_normal() -> None:
    assert normal_gravity(35.0) == pytest.approx(9.7973, abs=1e-4)


def test_earth_rate_is_along_the_axis() -> None:
    assert np.allclose(earth_rate_n(0.0), [0, EARTH_RATE_RAD_S, 0])
    assert np.allclose(earth_rate_n(90.0), [0, 0, EARTH_RATE_RAD_S], atol=1e-20)
    assert np.allclose(earth_rate_n(-90.0), [0, 0, -EARTH_RATE_RAD_S], atol=1e-20)
    assert np.linalg.norm(earth_rate_n(35.0)) == pytest.approx(EARTH_RATE_RAD_S)
    # once around in a sidereal day
    assert 2 * np.pi / EARTH_RATE_RAD_S == pytest.approx(86164.1, abs=0.1)
