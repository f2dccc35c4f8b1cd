"""The scale of a gain, from looks at a made-up scene; and its file."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from calibration.document import CameraIdentity, Finding
from calibration.gain import FIRST_LOOKS, MOST_LOOKS, GainCurve, GainFile, capture_gain, solve_gain
from calibration.sweep import Shot
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting, linear_gain
from imaging.gain_scale import GainScale

SHAPE = (96, 128)
Law = Callable[[float], float]
LIMITS = ExposureLimits(10.0, 1e6, 0.0, 240.0, 0.0, 1.0)


def decibels(number: float) -> float:
    return number / 10.0


def amplitude(number: float) -> float:
    return 20.0 * math.log10(1.0 + 15.0 * number / 240.0)


def reciprocal(number: float) -> float:
    return -20.0 * math.log10(1.0 - number / 256.0)


def then_digital(number: float) -> float:
    """Analog gain, then steps of a whole stop."""
    return number / 10.0 if number < 120 else 12.0 + 6.02 * ((number - 120) // 60)


@dataclass
class GainCamera:
    """Grey columns within three stops, in an order that is the scene, above a black level that rises with the gain."""

    law: Law = amplitude
    limits: ExposureLimits = LIMITS
    light: Callable[[int], float] = lambda shot: 1.0
    scene: Callable[[int], int] = lambda shot: 0
    full_well_e: float = 10_000.0
    shots: int = 0
    _random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))

    def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
        return [self._shot(setting) for _ in range(frames)]

    def _shot(self, setting: ExposureSetting) -> Shot:
        gain = linear_gain(self.law(setting.gain_db))
        columns = np.random.default_rng(self.scene(self.shots)).permutation(np.linspace(-3, 0, SHAPE[1] // 16))
        radiance = np.broadcast_to(np.exp2(np.repeat(columns, 16)), SHAPE) * self.light(self.shots)
        seen = np.minimum(self._random.poisson(radiance * setting.exposure_time_us), self.full_well_e)
        grey = 4.0 + 0.2 * gain + seen * gain * 255.0 / self.full_well_e + self._random.normal(0.0, 0.5, SHAPE)
        self.shots += 1
        return Shot(np.clip(np.rint(grey), 0, 255).astype(np.uint8), 8, setting, 0.02 * self.shots)


def measured(**camera: object) -> GainCurve:
    return solve_gain(capture_gain(GainCamera(**camera)))  # type: ignore[arg-type]


def worst_db(curve: GainCurve, law: Law) -> float:
    numbers = np.arange(241.0)
    seen_db = np.interp(numbers, curve.settings, curve.gains_db)
    return max(abs(float(seen_db[int(n)]) - law(n) + law(0.0)) for n in numbers)


@pytest.mark.parametrize("law", [decibels, amplitude, reciprocal])
def test_a_law_is_recovered_within_the_error_stated(law: Law) -> None:
    curve = measured(law=law)
    assert curve.findings == ()
    assert worst_db(curve, law) <= curve.error_db < 0.25
    assert len(curve.settings) <= MOST_LOOKS


def test_more_gains_are_looked_at_where_the_law_bends() -> None:
    straight, bent = measured(law=decibels), measured(law=amplitude)
    assert len(straight.settings) == FIRST_LOOKS
    gaps = np.diff(bent.settings)
    assert gaps[0] < gaps[-1] / 3


def test_light_that_drifts_steadily_cancels_and_is_reported() -> None:
    curve = measured(law=decibels, light=lambda shot: 1.0 + 2e-4 * shot)
    assert [finding.reason for finding in curve.findings] == ["light_changed"]
    assert {finding.severity for finding in curve.findings} == {"warned"}
    assert worst_db(curve, decibels) <= curve.error_db


@pytest.mark.parametrize(
    ("camera", "reason"),
    [
        ({"light": lambda shot: 1.0 if shot < 60 else 1.3}, "light_changed"),
        ({"light": lambda shot: 0.0}, "clipped"),
        ({"light": lambda shot: 1e4}, "clipped"),
        ({"law": lambda number: 0.0}, "no_effect"),
        ({"law": lambda number: 12.0 - number / 20.0}, "not_rising"),
        ({"law": lambda number: 6.0 * math.sin(number / 60.0)}, "not_rising"),
        ({"scene": lambda shot: shot // 60}, "moving_scene"),
    ],
)
def test_data_that_say_nothing_are_refused(camera: dict[str, object], reason: str) -> None:
    findings = {finding.reason: finding.severity for finding in measured(**camera).findings}
    assert findings.get(reason) == "refused", findings


def test_steps_of_a_stop_are_found_exactly() -> None:
    curve = measured(law=then_digital)
    assert worst_db(curve, then_digital) <= curve.error_db < 0.25


SCALE = GainScale("GainRaw", (0.0, 10.0, 20.0), (0.0, 1.5, 6.0))
MINIMUM = "format: autoexpose-gain/1\nnode: GainRaw\n"


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "left.gain.yaml"
    finding = Finding("warned", "light_changed", "one gain measured twice differs by 0.20 dB")
    identity = CameraIdentity("Maker", "Model 7", "0012")
    GainFile(SCALE, 0.05, camera=identity, tool="t", findings=(finding,)).save(path)
    loaded = GainFile.load(path)
    assert (loaded.scale, loaded.error_db, loaded.findings, loaded.path) == (SCALE, 0.05, (finding,), path)
    loaded.check_belongs("0012")
    with pytest.raises(ConfigurationError, match=r"camera.serial is 0012, but this is camera X: .*calibrate gain"):
        loaded.check_belongs("X")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "begin with 'format: autoexpose-gain/1'"),
        ("format: autoexpose-gain/2", "only 'autoexpose-gain/1' can be read"),
        (MINIMUM + "gains_db: [0.0, 1.0]", "the key 'settings' is missing"),
        (MINIMUM + "settings: [0.0, x]\ngains_db: [0.0, 1.0]", "give two or more numbers that rise"),
        (MINIMUM + "settings: [0.0]\ngains_db: [0.0]", "give two or more numbers that rise"),
        (MINIMUM + "settings: [0.0, 1.0, 2.0]\ngains_db: [0.0, 1.0]", "3 settings for 2 gains_db"),
        (MINIMUM + "settings: [0.0, 0.0]\ngains_db: [0.0, 1.0]", "settings must rise"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [1.0, 0.0]", "gains_db must rise"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0.0, 0.0]", "gains_db must rise"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0.0, .inf]", "give two or more numbers that rise"),
        (
            MINIMUM + "settings: [0, 1, 2]\ngains_db: [0, 1, 1.0e+308]",
            "gains_db[2] is 1e+308: give two or more",
        ),
        (MINIMUM + "settings: [0, 1, 2]\ngains_db: [0, 1, 101]", "-60 to 100 dB"),
        (MINIMUM + "settings: [0, 1.0e+300]\ngains_db: [0, 1]", "settings[1] is 1e+300: give two or more numbers"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0, 1]\nerror_db: 1.0e+9", "is 1000000000.0: give 0 to 100 dB"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0, 1]\nerror_db: -1", "error_db is -1: give 0 to 100 dB"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0.0, 1.0]\nlaw: cubic", "unknown key 'law'"),
    ],
)
def test_what_is_no_gain_file_is_refused_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "left.gain.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        GainFile.load(path)
    assert str(path) in str(refused.value)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
