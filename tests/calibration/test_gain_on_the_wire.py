"""`autoexpose calibrate gain` on fake cameras with a raw gain, and what the daemon then does in dim light."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from calibration.gain import GainFile
from fake_camera.genapi.raw_gain import RawGain
from imaging.gain_scale import GainScale
from tests.autoexpose_daemon.stereo import running_daemon
from tests.calibration.command_line import done
from tests.fakes import FakeCamera, fake_camera, unique
from tests.xml_shapes import xml_shape

LAWS = {"left": RawGain(law="amplitude"), "right": RawGain(law="decibels")}
SERIALS = {side: unique("GAIN")[:15] for side in LAWS}


@pytest.fixture
def description(tmp_path: Path) -> Path:
    path = tmp_path / "raw.xml"
    path.write_bytes(xml_shape("raw"))
    return path


def truth(description: Path, side: str) -> Path:
    return description.with_name(f"{side}.jsonl")


def camera(stack: ExitStack, side: str, lux: float, description: Path, line0: str) -> FakeCamera:
    """On a tripod under steady light."""
    light = description.with_name(f"{lux:g}.yaml")
    light.write_text(f"light: [{{at_s: 0, lux: {lux:g}}}]")
    options = ["--still", "--light", str(light), "--xml", str(description), "--raw-gain", LAWS[side].law]
    options += ["--truth", str(truth(description, side))]
    return stack.enter_context(fake_camera(SERIALS[side], side=side, line0=line0, options=options))


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
    for side, law in LAWS.items():
        numbers = tuple(float(number) for number in range(0, 241, 5))
        path = tmp_path / f"{side}.gain.yaml"
        GainFile(GainScale("GainRaw", numbers, tuple(map(law.gain_db, numbers)))).save(path)
        cameras[side] = {"serial": SERIALS[side], "gain_calibration": str(path)}
    settings = {
        "cameras": cameras,
        "trigger": {"line": "Line1", "rate_hz": 60},
        "image": {"pixel_format": "Mono8"},
        "control": {"policy": "neves2009"},
    }
    wire = unique("wire")
    with ExitStack() as stack:
        left, right = (camera(stack, side, 0.5, description, wire) for side in LAWS)
        truths = [truth(description, side) for side in LAWS]
        run = stack.enter_context(running_daemon((left, right, truths), settings, latched=False))

        def lit() -> bool:
            frames = list(run.seen[-1][0].frames.values()) if run.seen else []
            return bool(frames) and all(
                frame.setting.gain_db > 6.0 and abs(frame.pixels.mean() / 255 - 0.2) < 0.05 for frame in frames
            )

        run.wait_until(lit, "frames as bright as asked for, by gain")
