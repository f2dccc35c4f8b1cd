"""The scale of a gain, from looks at a made-up scene and over the wire; its file; and what it does in dim light."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from calibration.document import CameraIdentity, Finding
from calibration.gain import FIRST_LOOKS, MOST_LOOKS, GainCurve, GainFile, capture_gain, solve_gain
from calibration.sweep import Shot
from fake_camera.genapi.raw_gain import RawGain
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting, linear_gain
from imaging.gain_scale import GainScale
from tests.autoexpose_daemon.stereo import running_daemon
from tests.calibration.command_line import done
from tests.fakes import FakeCamera, fake_camera, unique
from tests.xml_shapes import xml_shape

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
        (MINIMUM + "settings: [0.0, 1.0, 2.0]\ngains_db: [0.0, 1.0]", "3 settings for 2 gains_db"),
        (MINIMUM + "settings: [0.0, 0.0]\ngains_db: [0.0, 1.0]", "settings must rise"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [1.0, 0.0]", "gains_db must rise"),
        (
            MINIMUM + "settings: [0, 1, 2]\ngains_db: [0, 1, 1.0e+308]",
            "gains_db[2] is 1e+308: give two or more",
        ),
        (MINIMUM + "settings: [0, 1, 2]\ngains_db: [0, 1, 101]", "-60 to 100 dB"),
        (MINIMUM + "settings: [0.0, 1.0]\ngains_db: [0, 1]\nerror_db: 1.0e+9", "is 1000000000.0: give 0 to 100 dB"),
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


LAWS = {"left": RawGain(law="amplitude"), "right": RawGain(law="decibels")}
SERIALS = {camera: unique("GAIN")[:15] for camera in LAWS}


@pytest.fixture
def description(tmp_path: Path) -> Path:
    path = tmp_path / "raw.xml"
    path.write_bytes(xml_shape("raw"))
    return path


def truth(description: Path, camera: str) -> Path:
    return description.with_name(f"{camera}.jsonl")


def camera(stack: ExitStack, name: str, lux: float, description: Path, line0: str) -> FakeCamera:
    """On a tripod under steady light."""
    light = description.with_name(f"{lux:g}.yaml")
    light.write_text(f"light: [{{at_s: 0, lux: {lux:g}}}]")
    options = ["--still", "--light", str(light), "--xml", str(description), "--raw-gain", LAWS[name].law]
    options += ["--truth", str(truth(description, name))]
    return stack.enter_context(fake_camera(SERIALS[name], side=name, line0=line0, options=options))


@pytest.mark.wire
def test_a_raw_gain_is_measured_as_it_is(tmp_path: Path, description: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.gain.FIRST_LOOKS", 3)
    monkeypatch.setattr("calibration.gain.MOST_LOOKS", 5)
    path, law = tmp_path / "left.gain.yaml", LAWS["left"]
    with ExitStack() as stack:
        camera(stack, "left", 600.0, description, unique("wire"))
        done("gain", "--camera", SERIALS["left"], "-o", str(path))
    loaded = GainFile.load(path)
    loaded.check_belongs(SERIALS["left"])
    assert loaded.scale.node == "GainRaw"
    assert loaded.scale.gains_db == pytest.approx([law.gain_db(number) for number in loaded.scale.settings], abs=0.1)
    assert max(abs(loaded.scale.gain_db(number) - law.gain_db(number)) for number in range(241)) <= loaded.error_db


@pytest.mark.realtime
def test_in_dim_light_a_calibrated_gain_is_used(tmp_path: Path, description: Path) -> None:
    cameras = {}
    for name, law in LAWS.items():
        numbers = tuple(float(number) for number in range(0, 241, 5))
        path = tmp_path / f"{name}.gain.yaml"
        GainFile(GainScale("GainRaw", numbers, tuple(map(law.gain_db, numbers)))).save(path)
        cameras[name] = {"serial": SERIALS[name], "gain_calibration": str(path)}
    settings = {
        "cameras": cameras,
        "trigger": {"line": "Line1", "rate_hz": 60},
        "image": {"pixel_format": "Mono8"},
        "control": {"policy": "neves2009"},
    }
    wire = unique("wire")
    with ExitStack() as stack:
        left, right = (camera(stack, name, 0.5, description, wire) for name in LAWS)
        truths = [truth(description, name) for name in LAWS]
        run = stack.enter_context(running_daemon((left, right, truths), settings, latched=False))

        def lit() -> bool:
            frames = list(run.seen[-1][0].frames.values()) if run.seen else []
            return bool(frames) and all(
                frame.setting.gain_db > 6.0 and abs(frame.pixels.mean() / 255 - 0.2) < 0.05 for frame in frames
            )

        run.wait_until(lit, "frames as bright as asked for, by gain")
