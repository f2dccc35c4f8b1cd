from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.world.lighting import Change, Flicker, LightScript

SCRIPT = """
repeat_s: 20
flicker: {frequency_hz: 100, depth: 0.8}
light:
  - {at_s: 0, lux: 150}
  - {at_s: 4, lux: 1}
  - {at_s: 8, lux: 50, ramp_s: 3}
"""


def script(tmp_path: Path, text: str) -> LightScript:
    path = tmp_path / "light.yaml"
    path.write_text(text)
    return LightScript.from_file(path)


def numeric_mean(light: LightScript, start_s: float, exposure_s: float) -> float:
    """Brute-force mean, midpoint rule."""
    times = start_s + exposure_s * (np.arange(20000) + 0.5) / 20000
    lux = np.array([light.lux(float(t)) for t in times])
    if light.flicker:
        wave = np.pi / 2 * np.abs(np.sin(np.pi * light.flicker.frequency_hz * times))
        lux *= 1 - light.flicker.depth + light.flicker.depth * wave
    return float(lux.mean())


def test_default_switches_between_150_and_1_lux_every_4_s() -> None:
    light = LightScript.default()
    assert [light.lux(t) for t in (0.0, 3.999, 4.0, 7.999, 8.0, 12.0, 16.0)] == [150, 150, 1, 1, 150, 1, 150]


def test_file_with_steps_ramps_and_repetition(tmp_path: Path) -> None:
    light = script(tmp_path, SCRIPT)
    assert [light.lux(t) for t in (0, 5, 8, 9.5, 11, 19, 20, 24.5)] == pytest.approx([150, 1, 1, 25.5, 50, 50, 150, 1])


def test_without_repetition_the_last_light_stays(tmp_path: Path) -> None:
    light = script(tmp_path, "light: [{at_s: 0, lux: 10}, {at_s: 2, lux: 3}]")
    assert light.lux(1e6) == 3
    assert light.mean_lux(-5.0, 1.0) == 10


def test_exposure_across_a_step_sees_both_sides() -> None:
    assert LightScript.default().mean_lux(4.0 - 0.003, 0.004) == pytest.approx(0.75 * 150 + 0.25 * 1)


@pytest.mark.parametrize(
    ("start_s", "exposure_s"), [(0.0, 0.0015), (3.996, 0.0075), (7.9, 3.3), (19.99, 0.02), (43.0, 0.007)]
)
def test_mean_is_exact(tmp_path: Path, start_s: float, exposure_s: float) -> None:
    light = script(tmp_path, SCRIPT)
    assert light.mean_lux(start_s, exposure_s) == pytest.approx(numeric_mean(light, start_s, exposure_s), rel=1e-3)


@given(st.floats(0, 50), st.floats(1e-5, 0.1), st.floats(1e-5, 0.1))
def test_mean_of_two_exposures_is_the_mean_of_their_union(start_s: float, first_s: float, second_s: float) -> None:
    light = LightScript((Change(0, 5), Change(3, 90, 2.5), Change(7, 1)), 9.0, Flicker(100.0, 0.7))
    both = light.mean_lux(start_s, first_s) * first_s + light.mean_lux(start_s + first_s, second_s) * second_s
    assert light.mean_lux(start_s, first_s + second_s) * (first_s + second_s) == pytest.approx(both, rel=1e-6, abs=1e-9)


def test_short_exposures_see_the_flicker_and_whole_periods_do_not() -> None:
    light = LightScript((Change(0, 100),), None, Flicker(100.0, 1.0))
    starts = np.arange(40) / 4000
    short = [light.mean_lux(float(s), 0.0005) for s in starts]
    whole = [light.mean_lux(float(s), 0.01) for s in starts]
    assert min(short) < 10
    assert max(short) > 150
    assert whole == pytest.approx([100.0] * 40)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("light: [{at_s: 0, lux: 1, colour: 3}]", r"light\[0\] has the unknown key 'colour'"),
        ("light: [{at_s: 0, lux: 1}]\nspeed: 2", "unknown key 'speed'"),
        ("repeat_s: 3", "lacks the key 'light'"),
        ("light: [{at_s: 0}]", r"light\[0\] lacks the key 'lux'"),
        ("light: [{at_s: 0, lux: bright}]", r"light\[0\].lux must be a number, not 'bright'"),
        ("light: [{at_s: 0, lux: .nan}]", r"light\[0\].lux must be a number"),
        ("light: [{at_s: 1, lux: 1}]", "must begin with a change at at_s 0"),
        ("light: []", "must begin with a change at at_s 0"),
        ("light: 5", "light must be a list"),
        ("light: [{at_s: 0, lux: -1}]", "negative"),
        ("light: [{at_s: 0, lux: 1}, {at_s: 2, lux: 1, ramp_s: 2}, {at_s: 3, lux: 1}]", "at_s 3 must come after"),
        ("light: [{at_s: 0, lux: 1}, {at_s: 2, lux: 1}]\nrepeat_s: 1", "repeat_s 1 must be later than the end"),
        ("light: [{at_s: 0, lux: 1}]\nflicker: {depth: 2}", "depth from 0 to 1"),
        ("light: [", "is not YAML"),
        ("- 3", "the script must be a mapping"),
    ],
)
def test_bad_scripts_are_refused_with_file_and_key(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as caught:
        script(tmp_path, text)
    assert "light.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"none\.yaml cannot be read"):
        LightScript.from_file(tmp_path / "none.yaml")
