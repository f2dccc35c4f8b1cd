"""`autoexpose calibrate noise` and `autoexpose calibrate latency`, on fake cameras over the wire."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.commands import measure_noise
from calibration.commands.measure_noise import (
    latency_document,
    noise_document,
    when_it_shows,
)
from calibration.document import CameraIdentity, Finding
from calibration.latency import WriteEffect
from calibration.noise.light_lines import Estimate, NoiseModel
from calibration.noise.photon_transfer import PhotonTransfer, default_gains_db, plan_noise
from calibration.response.file import Origin, ResponseFile
from calibration.session import session_setup
from drivers.aravis import open_camera
from fake_camera.world.sensor import SensorModel
from imaging.errors import CameraError, ConfigurationError
from imaging.exposure import ExposureLimits
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from tests.calibration.command_line import calibrate, done, refused
from tests.calibration.sweeps import LIMITS, MadeUpCamera, linear
from tests.fakes import FakeCamera, fake_camera

SENSOR = SensorModel()
MODEL = NoiseModel(
    gain_db=12.0,
    bit_depth=12,
    system_gain=Estimate(0.74102, 0.00123),
    black_level_dn=Estimate(41.04, 0.31),
    read_noise_dn=Estimate(2.2, 0.05),
    read_noise_e=Estimate(2.9713, 0.046),
    saturation_dn=4095.0,
    full_well_e=Estimate(5471.3, 12.0),
)
MEASURED = PhotonTransfer(MODEL, ())
EFFECT = WriteEffect("gain", {1: 19, 2: 1}, 3, (1.0, 2.0), 2100.0, ())
DRIFT = Finding("warned", "light_drift", "the light changed: use steady light")


@pytest.mark.parametrize(
    ("delay_us", "text"),
    [
        ((-2100.0, 11_000.0), "exposures that start 11.0 ms after the write, and earlier ones perhaps, show it"),
        ((13_000.0, 29_000.0), "exposures that start 13.0 ms after the write do not show it, 29.0 ms do"),
        ((29_000.0, 13_000.0), "does not decide"),
    ],
)
def test_latency_is_clear_in_time_as_well(delay_us: tuple[float, float], text: str) -> None:
    told = when_it_shows(replace(EFFECT, delay_us=delay_us))
    assert told.startswith("gain: written 2.1 ms after the start of an exposure; ")
    assert text in told


def response_file(path: Path, serial: str) -> Path:
    identity = CameraIdentity("Autoexpose", "FakeGV287M", serial)
    ResponseFile(ResponseFunction.linear(0), Origin(identity, PixelFormat.MONO8)).save(path)
    return path


def test_what_is_added_to_a_response_file_is_read_back_with_its_doubts(tmp_path: Path) -> None:
    path = tmp_path / "a.response.yaml"
    doubted = PhotonTransfer(replace(MODEL, gain_db=18.0), (DRIFT,))
    noise = noise_document("Mono12", [MEASURED, doubted])
    latency = latency_document(60.0, [EFFECT, replace(EFFECT, quantity="exposure", findings=(DRIFT,))])
    ResponseFile(ResponseFunction.linear(0), noise=noise, latency=latency).save(path)
    loaded = ResponseFile.load(path)
    assert (loaded.noise, loaded.latency) == (noise, latency)
    said = [{"severity": "warned", "reason": "light_drift", "text": "the light changed: use steady light"}]
    assert loaded.noise["gains"][0]["system_gain"] == [0.74102, 0.00123]
    assert [gain.get("findings") for gain in loaded.noise["gains"]] == [None, said]
    assert loaded.latency["gain"] == {"mode_frames": 1, "frames": {1: 19, 2: 1}, "untold": 3}
    assert loaded.latency["exposure"]["findings"] == said


def test_gains_measured_before_stay_unless_they_are_measured_again() -> None:
    def at(gain_db: float, black_level_dn: float) -> PhotonTransfer:
        return PhotonTransfer(replace(MODEL, gain_db=gain_db, black_level_dn=Estimate(black_level_dn, 0.1)), ())

    def black_levels(noise: dict[str, Any]) -> dict[float, float]:
        return {gain["gain_db"]: gain["black_level_dn"][0] for gain in noise["gains"]}

    refused = PhotonTransfer(None, (Finding("refused", "no_noise", "no noise shows"),))
    first = noise_document("Mono12", [at(12.0, 1.0), at(0.0, 2.0)])
    assert list(black_levels(first)) == [0.0, 12.0]
    again = noise_document("Mono12", [at(6.0, 3.0), at(12.0, 4.0), refused], first)
    assert black_levels(again) == {0.0: 2.0, 6.0: 3.0, 12.0: 4.0}
    assert black_levels(noise_document("Mono8", [at(6.0, 3.0)], first)) == {6.0: 3.0}
    edited: list[Any] = [{}, {"gains": 3}, {"gains": [3, {"gain_db": "3"}, {"gain_db": 3, "black_level_dn": [5.0]}]}]
    kept = [black_levels(noise_document("Mono12", [refused], {"pixel_format": "Mono12"} | noise)) for noise in edited]
    assert kept == [{}, {}, {3: 5.0}]


@pytest.mark.parametrize("command", ["noise", "latency"])
def test_files_that_cannot_be_added_to_are_refused_before_the_camera_is_looked_for(
    command: str, tmp_path: Path
) -> None:
    missing, other = tmp_path / "none.yaml", response_file(tmp_path / "other.yaml", "OTHER")
    assert f"make it first with autoexpose calibrate response --camera S -o {missing}" in refused(
        command, "--camera", "S", "-o", str(missing)
    )
    assert "camera.serial is OTHER, but this is camera S" in refused(command, "--camera", "S", "-o", str(other))


@pytest.mark.parametrize("computed", [PixelFormat.RGB8, PixelFormat.BGR8, PixelFormat.YUV422_8])
def test_noise_of_formats_that_the_camera_computes_is_refused_with_those_that_serve(
    computed: PixelFormat, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = refused("noise", "--camera", "S", "--pixel-format", computed)
    assert f"camera S: {computed} is computed from several pixels" in output
    assert "its Mono formats, or of its Bayer formats, whose green is measured" in output
    with pytest.raises(ConfigurationError, match="is computed from several pixels"):
        measure_noise._check_raw("S", computed)  # the camera's own, where it has no grey format
    for raw in (PixelFormat.MONO12P, PixelFormat.BAYER_RG12, None):
        measure_noise._check_raw("S", raw)


@pytest.mark.parametrize(
    ("lowest_db", "highest_db", "gains_db"),
    [
        (0.0, 0.0, (0.0,)),
        (0.0, 48.0, (0.0, 16.0, 32.0, 48.0)),
        (-1.0, 23.0, (-1.0, 7.0, 15.0, 23.0)),
        (0.04, 47.994, (0.04, 16.0, 32.0, 47.994)),
    ],
)
def test_gains_are_spread_over_what_the_camera_has(
    lowest_db: float, highest_db: float, gains_db: tuple[float, ...]
) -> None:
    assert default_gains_db(ExposureLimits(10.0, 1e6, lowest_db, highest_db)) == gains_db


@pytest.mark.parametrize("light", [0.3, 1.0, 100.0])
def test_exposures_go_from_almost_no_light_to_saturation(light: float) -> None:
    camera = MadeUpCamera(linear, light=lambda shot: light)
    plan = plan_noise(camera, 0.0)
    times_us = [setting.exposure_time_us for setting in plan.settings]
    *once_us, again_us = times_us
    assert once_us == sorted(once_us)
    assert once_us[0] >= LIMITS.min_time_us
    assert again_us in once_us
    darkest, brightest = (camera.take(plan.settings[index], 1)[0].pixels for index in (0, -2))
    assert np.median(darkest) <= 4
    assert np.median(brightest) == 255
    assert plan.frames == 2


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    path = tmp_path_factory.mktemp("light") / "light.yaml"
    path.write_text("light: [{at_s: 0, lux: 60}]")
    return ["--still", "--light", str(path)]


@pytest.fixture(scope="module")
def fake(light: list[str]) -> Iterator[FakeCamera]:
    with fake_camera(options=light) as camera:
        yield camera


@pytest.mark.wire
def test_noise_over_the_wire_is_that_of_the_sensor(fake: FakeCamera, tmp_path: Path) -> None:
    gain_db = 24.0
    file = response_file(tmp_path / "left.response.yaml", fake.serial)
    before = noise_document("Mono12", [MEASURED])
    replace(ResponseFile.load(file), noise=before).save(file)
    output = done("noise", "--camera", fake.serial, "--gain-db", str(gain_db), "-o", str(file))
    assert f"camera {fake.serial}, Mono12" in output
    assert f"written: {file}" in output
    noise = ResponseFile.load(file).noise
    assert noise["pixel_format"] == "Mono12"
    former, measured = noise["gains"]
    assert [former] == before["gains"]
    system_gain = SENSOR.system_gain("Mono12", gain_db)
    assert measured["gain_db"] == gain_db
    assert measured["system_gain"][0] == pytest.approx(system_gain, rel=0.03)
    assert measured["read_noise_e"][0] == pytest.approx(SENSOR.read_noise_e, rel=0.10)
    assert measured["full_well_e"][0] == pytest.approx(4095.0 / system_gain, rel=0.03)
    assert abs(measured["black_level_dn"][0]) < 1.0
    with closing(open_camera(fake.serial, session_setup())) as camera:
        assert camera.description.pixel_format == "Mono8"  # as before


@pytest.mark.wire
def test_noise_of_a_camera_with_a_curve_is_refused(light: list[str]) -> None:
    with fake_camera(options=[*light, "--response", "gamma"]) as fake:
        output = refused("noise", "--camera", fake.serial, "--gain-db", "30", "--pixel-format", "Mono8")
    assert "refused at 30 dB: grey levels are up to" in output
    assert "photon transfer needs a linear response" in output


@pytest.mark.realtime
def test_latency_over_the_wire(fake: FakeCamera, tmp_path: Path) -> None:
    file = response_file(tmp_path / "left.response.yaml", fake.serial)
    output = done("latency", "--camera", fake.serial, "--writes", "7", "-o", str(file))
    assert "frames until it shows" in output
    assert "exposure: written " in output
    latency = ResponseFile.load(file).latency
    assert latency["rate_hz"] == 60.0
    # On a busy machine writes miss an exposure; tests/accept/test_latency.py has them show in the next one.
    assert all(latency[quantity]["mode_frames"] >= 1 for quantity in ("exposure", "gain"))


@pytest.mark.wire
def test_a_camera_lost_while_it_is_measured_is_clear_as_such(fake: FakeCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    def measure(*arguments: object) -> None:
        def lost(*arguments: object) -> None:
            raise ConfigurationError("no such camera")

        monkeypatch.setattr(measure_noise, "open_camera", lost)
        raise CameraError("no whole frame arrived")

    monkeypatch.setattr(measure_noise, "_measure", measure)
    assert calibrate("noise", "--camera", fake.serial) == (1, "autoexpose: no whole frame arrived")


@pytest.mark.wire
def test_a_scene_too_dark_is_clear_once_and_without_a_table(fake: FakeCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    dark = Finding("refused", "too_dark", "the scene is too dark")
    effects = [WriteEffect(quantity, {}, 0, None, None, (dark,)) for quantity in ("exposure", "gain")]
    monkeypatch.setattr(measure_noise, "capture_latency", lambda *arguments: effects)
    output = refused("latency", "--camera", fake.serial)
    assert (output.count("refused: the scene is too dark"), "frames until it shows" in output) == (1, False)


@pytest.mark.wire
def test_a_gain_that_the_camera_lacks_is_refused(fake: FakeCamera) -> None:
    assert "its gain is 0 to 47 dB, not 60 dB" in refused("noise", "--camera", fake.serial, "--gain-db", "60")
