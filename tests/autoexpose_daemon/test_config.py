from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.config import Config, load_config
from drivers.errors import ConfigurationError
from drivers.exposure import ExposureSetting

STEREO = {"cameras": {"left": {"serial": "A"}, "right": {"serial": "B"}}}


def complaint(tmp_path: Path, text: str) -> str:
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_config(file)
    message = str(caught.value)
    assert str(file) in message
    return message


def test_a_short_file_has_the_documented_defaults(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("cameras: {left: {serial: '1'}, right: {serial: '2'}}")
    config = load_config(file)
    limits = config.exposure.limits()
    assert (limits.min_time_us, limits.max_time_us, limits.min_gain_db, limits.max_gain_db) == (20, 7500, 0, 30)
    assert (config.trigger.mode, config.trigger.rate_hz) == ("external", 60)
    assert config.start == ExposureSetting(2000, 0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cameras: {left: {serial: A}}\nexposure: {max_time: 5000}", ["exposure.max_time:", "max_time_us"]),
        ("cameras: {left: {serial: A, respnse: x}}", ["cameras.left.respnse", "cameras.left.response"]),
        ("camera: {}", ["camera: unknown key", "cameras"]),
        ("exposure: {}", ["cameras: is missing"]),
        ("cameras: {left: {serial: A}}\ncontrol: {policy: begin2021}", ["begin2021", "did you mean begin2022"]),
        ("cameras: {left: {serial: A}}\nexposure: {min_time_us: 900, max_time_us: 30}", ["exposure:", "900"]),
        ("cameras: {left: {serial: A}}\nexposure: {max_time_us: 20000}", ["20000", "trigger.rate_hz"]),
        ("cameras: {left: {serial: A}}\nexposure: {max_time_us: .nan}", ["exposure.max_time_us"]),
        ("cameras: {left: {serial: A}}\ncontrol: {start: {exposure_time_us: 9000}}", ["control.start", "9000"]),
        ("cameras: {left: {serial: A}, right: {serial: A}}", ["same camera"]),
        ("cameras: {left: {serial: A}, right: {serial: B}}\ntrigger: {mode: free_run}", ["free_run"]),
        ("cameras: {left: {serial: A, response: missing.yaml}}", ["missing.yaml"]),
        ("[1, 2", ["YAML"]),
        ("just words", ["cameras"]),
    ],
)
def test_a_mistake_is_named_with_its_key(tmp_path: Path, text: str, words: list[str]) -> None:
    message = complaint(tmp_path, text)
    for word in words:
        assert word in message


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no-such"):
        load_config(tmp_path / "no-such.yaml")


def test_a_configured_start_is_taken_to_the_letter() -> None:
    config = Config.model_validate(STEREO | {"control": {"start": {"exposure_time_us": 300}}})
    assert config.start == ExposureSetting(300.0, 0.0)


@given(st.floats(1.0, 7000.0), st.floats(1.0, 7000.0))
def test_the_start_is_always_within_the_bounds(low: float, high: float) -> None:
    low, high = sorted((low, high))
    config = Config.model_validate(STEREO | {"exposure": {"min_time_us": low, "max_time_us": high, "max_gain_db": 5}})
    assert low <= config.start.exposure_time_us <= high
    assert 0 <= config.start.gain_db <= 5
