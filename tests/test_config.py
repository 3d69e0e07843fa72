"""The configuration: defaults, typos, files."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError

from graphnav.config import Config
from graphnav.errors import ConfigError

NAN, INF = float("nan"), float("inf")

CHANGED = {
    "covariance": False,
    "keyframes": {"interval_s": 0.5, "distance_m": 0.25, "events": False},
    "imu": {"minor_interval_s": 0.05, "bias_epoch_s": 30.0},
    "odometer": {"form": "velocity", "scale_walk_sqrt_h": 1e-6},
    "rest": {"use": False},
    "closed_path": {"form": "absolute", "interval_m": 6.0, "along": "all"},
    "position": {"use": False},
    "batch": {"max_iterations": 50},
    "isam2": {"keyframes_per_update": 5},
}


def test_nothing_given_is_the_default() -> None:
    assert Config.from_dict({}) == Config()
    assert Config().covariance


def test_values_arrive() -> None:
    config = Config.from_dict(CHANGED)
    assert config.keyframes.distance_m == 0.25
    assert config.closed_path.form == "absolute"
    assert config.rest.use is False
    assert config.rest.velocity_sigma_m_s == Config().rest.velocity_sigma_m_s


@pytest.mark.parametrize("values", [{}, CHANGED])
def test_toml_round_trip(values: dict[str, object], tmp_path: Path) -> None:
    """What a run writes beside its results starts the same run again."""
    config, path = Config.from_dict(values), tmp_path / "config.toml"
    path.write_text(config.to_toml(), encoding="utf-8")
    assert Config.from_toml(path) == config
    written = tomllib.loads(config.to_toml())
    assert set(written) == set(Config.model_fields)
    assert ("distance_m" in written["keyframes"]) == (config.keyframes.distance_m is not None)


def test_whole_numbers_are_numbers() -> None:
    """``interval_s = 1`` in TOML."""
    assert Config.from_dict({"keyframes": {"interval_s": 1}}).keyframes.interval_s == 1.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"keyframe": {}}, 'unknown key keyframe; did you mean "keyframes"?'),
        ({"zzz": {}}, "unknown key zzz; expected one of: keyframes, imu, odometer, "),
        ({"keyframes": {"intervall_s": 1.0}}, 'unknown key keyframes.intervall_s; did you mean "interval_s"?'),
        (
            {"keyframes": {"interval": 1.0}},
            'unknown key keyframes.interval; did you mean "interval_s" (the unit is part of the name)?',
        ),
        ({"uwb": {"los": "huber"}}, 'unknown key uwb.los; did you mean "loss"?'),
        ({"uwb": {"zzz": 1}}, "unknown key uwb.zzz; expected one of: use, loss, "),
        ({"keyframes": {"interval_s": 0.0}}, "keyframes.interval_s: 0.0, expected a number above 0"),
        ({"keyframes": {"interval_s": -1.0}}, "keyframes.interval_s: -1.0, expected a number above 0"),
        ({"keyframes": {"interval_s": NAN}}, "keyframes.interval_s: nan, expected a finite number"),
        ({"keyframes": {"interval_s": INF}}, "keyframes.interval_s: inf, expected a finite number"),
        ({"keyframes": {"interval_s": "1"}}, 'keyframes.interval_s: "1", expected a number'),
        ({"keyframes": {"interval_s": True}}, "keyframes.interval_s: true, expected a number"),
        ({"keyframes": {"events": 1}}, "keyframes.events: 1, expected true or false"),
        ({"keyframes": 3}, "keyframes: 3, expected a section; write its keys under [keyframes]"),
        ({"keyframes": [1]}, "keyframes: [1], expected a section"),
        ({"batch": {"max_iterations": 0}}, "batch.max_iterations: 0, expected a number of 1 or more"),
        ({"batch": {"max_iterations": 2.5}}, "batch.max_iterations: 2.5, expected a whole number"),
        ({"stereo_motions": {"shared": 1}}, "stereo_motions.shared: 1, expected a number below 1"),
        ({"lidar_filter": {"mode": 10}}, "lidar_filter.mode: 10, expected a number of 9 or less"),
        (
            {"closed_path": {"form": "relativ"}},
            "closed_path.form: \"relativ\", expected 'relative', 'absolute' or 'off'",
        ),
        ({"odometer": {"form": 3}}, "odometer.form: 3, expected 'displacement' or 'velocity'"),
    ],
)
def test_mistakes_are_named(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^configuration: {re.escape(message)}"):
        Config.from_dict(values)


def test_no_mistake_is_told_in_the_words_of_the_library() -> None:
    """Every setting, given what no setting takes."""
    for section, model in Config():
        for name in type(model).model_fields if isinstance(model, BaseModel) else ():
            for wrong in ({}, [], "?", -1e9, NAN):
                with pytest.raises(ConfigError, match=rf"^configuration: {section}\.{name}: .*, expected") as caught:
                    Config.from_dict({section: {name: wrong}})
                assert "Input" not in str(caught.value)


def test_mistakes_in_a_file_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "my.toml"
    path.write_text("[imu]\nbias_epoch = 3.0\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r'my\.toml: unknown key imu\.bias_epoch; did you mean "bias_epoch_s"'):
        Config.from_toml(path)
    path.write_text("[imu\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"my\.toml: not valid TOML \(.*line 1"):
        Config.from_toml(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match=r"my\.toml: not valid TOML"):
        Config.from_toml(path)
    with pytest.raises(ConfigError, match=r"other\.toml: no such file"):
        Config.from_toml(tmp_path / "other.toml")
    with pytest.raises(ConfigError, match=r"cannot be read"):
        Config.from_toml(tmp_path)


def test_a_configuration_does_not_change() -> None:
    with pytest.raises(ValidationError):
        Config().keyframes.interval_s = 2.0  # type: ignore[misc]


def test_every_number_of_the_default_is_written() -> None:
    """No setting is hidden from config.toml but those that stand for "none"."""
    written = tomllib.loads(Config().to_toml())
    missing = [
        f"{section}.{name}"
        for section, model in Config()
        if not isinstance(model, bool)
        for name in type(model).model_fields
        if name not in written[section]
    ]
    filter_ = ["lidar_filter.mode", "lidar_filter.distance_m", "uwb_filter.bias_time_s", "uwb_filter.gate_sigmas"]
    assert missing == ["keyframes.distance_m", "closed_path.interval_m", "lidar.together_m", *filter_]
