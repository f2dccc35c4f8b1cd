"""A session on a camera: which exposures a sweep and a check take, and that each shot shows its setting."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from calibration import session as session_module
from calibration.commands.app import judge_agreement, plan_check
from calibration.commands.rig import rig_of_config
from calibration.response.file import ResponseSolution
from calibration.response.tones import agreement, compare, tones_by_exposure
from calibration.session import FRAMES_TO_OBEY, Session, session_setup
from calibration.sweep import KEPT_PIXELS, LONGEST_TIME_US, Shot, SweepPlan, exposure_span_us, plan_sweep
from drivers.aravis import open_camera
from drivers.camera import CameraDescription, IncompleteFrame
from drivers.genicam.features import refuse_driven
from drivers.genicam.metadata import FRAMES_AFTER
from drivers.setup import FeatureSetting, LinkShare
from imaging.errors import CameraError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, SettingSource
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from tests.calibration.sweeps import LIMITS, Curve, MadeUpCamera, gamma, linear, sweep
from tests.fakes import fake_camera

BEFORE = ExposureSetting(1000.0, 0.0)
DESCRIPTION = CameraDescription("ours", "obedient", "S")
AFTER = ExposureSetting(4000.0, 6.0)


@dataclass
class ObedientCamera:
    """Shows a write `latency` frames later; starts an exposure whenever it is asked for a frame."""

    latency: int = 2
    source: SettingSource = "chunk"
    silent: bool = False
    broken: bool = False
    closed: bool = False
    description: CameraDescription = DESCRIPTION
    limits: ExposureLimits = LIMITS
    _settings: list[ExposureSetting] = field(default_factory=lambda: [BEFORE])
    _ids: Iterator[int] = field(default_factory=lambda: itertools.count(1))

    def start(self) -> None: ...

    def next_frame(self, timeout_s: float) -> Frame | IncompleteFrame | None:
        if self.silent:
            return None
        frame_id, now_ns = next(self._ids), time.monotonic_ns()
        if self.broken:
            return IncompleteFrame(frame_id, now_ns)
        shown = self._settings.pop(0) if len(self._settings) > 1 else self._settings[0]
        grey = np.full((2, 2), shown.exposure_time_us / 100.0, np.uint8)
        told = shown if self.source == "chunk" else self._settings[-1]  # a ledger that knows no latency yet
        return Frame(grey, 8, frame_id, now_ns, now_ns, now_ns, told, self.source)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        taken = ExposureSetting(round(setting.exposure_time_us), setting.gain_db)
        self._settings = [self._settings[0]] * self.latency + [taken]
        return taken

    def latch_clock(self) -> None: ...

    def close(self) -> None:
        self.closed = True


@pytest.fixture(autouse=True)
def _prompt_frames(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """The obedient camera takes frames without any pause, and none of them queues."""
    if request.node.get_closest_marker("realtime") is None and request.node.get_closest_marker("wire") is None:
        monkeypatch.setattr(session_module, "LATE_NS", 0)


@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("source", ["chunk", "ledger"])
def test_shots_are_those_that_show_the_setting_read_back(latency: int, source: SettingSource) -> None:
    session = Session(ObedientCamera(latency, source))
    for setting in (BEFORE, AFTER, ExposureSetting(2000.4, 0.0)):
        shots = session.take(setting, 3)
        assert len(shots) == 3
        expected = round(setting.exposure_time_us)
        assert {shot.setting.exposure_time_us for shot in shots} == {expected}
        assert {float(shot.pixels.mean()) for shot in shots} == {expected // 100}


def test_a_setting_that_stands_is_not_waited_for_anew() -> None:
    camera = ObedientCamera(0, "ledger")
    session = Session(camera)
    session.take(AFTER, 1)
    session.take(AFTER, 1)
    assert next(camera._ids) == FRAMES_AFTER + 3


def test_a_camera_that_never_takes_the_setting_is_clear_with_what_it_shows() -> None:
    session = Session(ObedientCamera(latency=2 * FRAMES_TO_OBEY))
    with pytest.raises(
        CameraError, match=r"read back 4000 us, 6\.0 dB, but 16 frames later still exposes with 1000 us"
    ):
        session.take(AFTER, 1)


@pytest.mark.parametrize("fault", ["silent", "broken"])
def test_a_camera_without_whole_frames_is_clear(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, "PATIENCE_S", 0.02)
    session = Session(ObedientCamera(**{fault: True}))
    with pytest.raises(CameraError, match=r"camera S: no whole frame arrived within 0\.0 s: check its cable"):
        session.take(AFTER, 1)


def test_the_session_closes_its_camera_whatever_happened() -> None:
    camera = ObedientCamera()
    with pytest.raises(RuntimeError), Session(camera):
        raise RuntimeError
    assert camera.closed


@pytest.mark.wire
def test_a_session_over_the_wire_from_the_shortest_exposure_to_a_long_one(tmp_path: Path) -> None:
    light = tmp_path / "light.yaml"
    light.write_text("light: [{at_s: 0, lux: 20}]")
    with (
        fake_camera(options=["--still", "--light", str(light)]) as fake,
        Session(open_camera(fake.serial, session_setup(PixelFormat.MONO12))) as session,
    ):
        short, mid, long = (
            session.take(ExposureSetting(time_us, gain_db), 2)
            for time_us, gain_db in [(session.limits.min_time_us, 0.0), (3000.0, 6.0), (400_000.0, 0.0)]
        )
    assert [shots[0].setting.exposure_time_us for shots in (short, mid, long)] == [10.0, 3000.0, 400_000.0]
    means = [float(shots[0].pixels.mean()) for shots in (short, mid, long)]
    assert means[0] < means[1] < means[2]
    assert mid[0].bit_depth == 12
    one, two = (shot.pixels.astype(np.float64) for shot in mid)
    assert np.abs(two - one).mean() < 50.0, "the camera stands still under steady light"


def test_the_features_of_a_configuration_are_set_for_a_calibration_too(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("cameras: {left: {serial: A, features: [Width: 320]}, right: {serial: B}}")
    assert [mode.setup().features for mode in rig_of_config(file)] == [(FeatureSetting("Width", 320),), ()]
    file.write_text("cameras: {left: {serial: A, features: {Width: 320}}}")
    with pytest.raises(ConfigurationError, match=r"rig\.yaml: cameras\.left\.features: is not a list"):
        rig_of_config(file)


def test_what_a_calibration_sets_itself_is_left_out_of_the_features(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("cameras: {left: {serial: A, features: [GainRaw: 3, AcquisitionFrameRate: 9.5, Width: 320]}}")
    (mode,) = rig_of_config(file)
    assert [feature.name for feature in mode.setup().features] == ["GainRaw", "AcquisitionFrameRate", "Width"]
    assert [feature.name for feature in mode.setup(20.0).features] == ["GainRaw", "Width"]
    own = mode.setup(own_gain=True)
    assert [feature.name for feature in own.features] == ["AcquisitionFrameRate", "Width"]
    assert not list(refuse_driven(own)) and not list(refuse_driven(mode.setup(20.0)))


def test_the_transport_and_the_rate_of_a_configuration_hold_for_a_calibration_too(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    cameras = "cameras: {left: {serial: A}, right: {serial: B}}"
    file.write_text(cameras)
    assert {(mode.rate_hz, mode.packet_size_bytes, mode.link_share) for mode in rig_of_config(file)} == {(None,) * 3}
    file.write_text(
        cameras + "\ntransport: {plan: true, link_mbps: 500, packet_size_bytes: 8000}\ntrigger: {rate_hz: 8}"
    )
    for mode in rig_of_config(file):
        setup = mode.setup(20.0)
        assert (mode.rate_hz, setup.packet_size_bytes, setup.link_share) == (8, 8000, LinkShare(2, 500))
    for wrong, why in (
        ("trigger: {rate_hz: -1}", "trigger.rate_hz is -1: give 0.1 to 1000 Hz"),
        ("transport: {packet_size_bytes: big}", "transport.packet_size_bytes is 'big': give 576 to 16000 bytes"),
    ):
        file.write_text(f"{cameras}\n{wrong}")
        with pytest.raises(ConfigurationError, match=why):
            rig_of_config(file)


@pytest.mark.parametrize("curve", [linear, gamma])
@pytest.mark.parametrize("black", [0.0, 20.0])
@pytest.mark.parametrize("full", [255.0, 230.0])
def test_a_sweep_goes_from_nearly_all_black_to_nearly_all_white(curve: Curve, black: float, full: float) -> None:
    limits = ExposureLimits(0.01, 1e6, 0.0, 0.0)
    camera = MadeUpCamera(curve, limits, black, full, light=lambda shot: 8.0)
    low_us, high_us = exposure_span_us(camera, 0.0)
    dark, white = (camera.take(ExposureSetting(time_us, 0.0), 1)[0].pixels for time_us in (low_us, high_us))
    assert np.percentile(dark, 95) <= black + 12
    assert np.percentile(white, 5) >= full - 6
    assert camera.shots < 25


def test_the_range_ends_at_the_cameras_bounds_and_at_what_is_worth_the_wait() -> None:
    bounded = MadeUpCamera(limits=ExposureLimits(100.0, 8000.0, 0.0, 0.0))
    assert exposure_span_us(bounded, 0.0) == (100.0, 8000.0)
    dim = MadeUpCamera(light=lambda shot: 1e-4)
    assert exposure_span_us(dim, 0.0)[1] == LONGEST_TIME_US


def test_exposures_are_taken_up_and_down_again_at_one_gain() -> None:
    plan = plan_sweep(MadeUpCamera(), 3.0)
    times_us = [setting.exposure_time_us for setting in plan.settings]
    assert times_us == times_us[::-1]
    half = times_us[: len(times_us) // 2]
    assert (np.diff(np.log2(half)) < 0.51).all()
    assert (np.diff(half) > 0).all()
    assert {setting.gain_db for setting in plan.settings} == {3.0}


@pytest.mark.parametrize(("max_gain_db", "known"), [(30.0, True), (13.0, True), (11.0, False), (3.0, False)])
def test_a_brighter_sweep_has_the_same_times_at_about_four_times_the_gain(max_gain_db: float, known: bool) -> None:
    limits = ExposureLimits(10.0, 1e6, 0.0, max_gain_db)
    plan = plan_sweep(MadeUpCamera(limits=limits), 3.0)
    brighter = plan.brighter(limits)
    assert (brighter is not None) == known
    if brighter is not None:
        (gain_db,) = {setting.gain_db for setting in brighter.settings}
        assert 9.0 <= gain_db - 3.0 <= 15.0
        assert gain_db <= max_gain_db
        assert [s.exposure_time_us for s in brighter.settings] == [s.exposure_time_us for s in plan.settings]


def test_grey_levels_of_a_brighter_sweep_lie_between_the_others() -> None:
    plan = plan_sweep(MadeUpCamera(), 0.0)
    brighter = plan.brighter(LIMITS)
    levels = np.unique([setting.level for setting in plan.settings])
    assert np.interp(brighter.settings[0].level, levels, np.arange(len(levels))) % 1.0 == pytest.approx(0.5, abs=0.01)


def test_large_images_are_thinned() -> None:
    class LargeCamera(MadeUpCamera):
        def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
            return [Shot(np.zeros((2000, 3000), np.uint16), 12, setting)] * frames

    ((_, shots),) = SweepPlan((ExposureSetting(100.0, 0.0),), 2).run(LargeCamera())
    assert len(shots) == 2
    assert KEPT_PIXELS / 2 < shots[0].pixels.size <= KEPT_PIXELS


GAMMA = ResponseFunction(2.2 * np.log2(np.maximum(np.arange(256), 0.5) / 255), 0, 255)
TIMES_US = np.geomspace(100, 16000, 12)


def test_the_true_curve_predicts_the_images_to_a_part_of_a_grey_level() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), TIMES_US)))
    assert match.enough
    assert match.residual_grey < 0.5
    assert judge_agreement(match, "0012") == []
    low, high = match.range_grey
    assert low < 15
    assert high > 240
    assert np.abs(match.near(2.0).delta_levels - 2.0).max() <= 0.25


def test_a_wrong_curve_is_off_by_many() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(linear), TIMES_US)))
    assert match.residual_grey > 10
    (finding,) = judge_agreement(match, "0012")
    assert finding.severity == "refused"
    assert "autoexpose calibrate response --camera 0012" in finding.text


def test_exposures_far_apart_are_still_compared_with_their_neighbours() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), [250, 2000, 16000])))
    assert match.enough
    assert np.abs(match.delta_levels) == pytest.approx(3.0)


def test_an_image_all_black_gives_nothing_to_compare() -> None:
    dark = MadeUpCamera(light=lambda shot: 0.0)
    match = agreement(GAMMA, tones_by_exposure(sweep(dark, TIMES_US)))
    assert [finding.reason for finding in judge_agreement(match, "0012")] == ["nothing_to_compare"]


@pytest.mark.parametrize("brightness", [1.0, 0.2, 300.0])
def test_a_check_puts_the_scene_where_two_stops_lie_on_either_side(brightness: float) -> None:
    camera = MadeUpCamera(light=lambda shot: brightness, limits=ExposureLimits(0.1, 1e9, 0.0, 0.0))
    plan = plan_check(camera, GAMMA, 0.0)
    times_us = sorted({setting.exposure_time_us for setting in plan.settings})
    assert len(times_us) == 9
    assert times_us[-1] / times_us[0] == pytest.approx(16.0)
    (middle,) = camera.take(ExposureSetting(times_us[4], 0.0), 1)
    assert 100 < np.median(middle.pixels) < 170


def test_a_check_against_a_curve_that_no_camera_has_ends() -> None:
    foreign = ResponseFunction(np.arange(256) * 1e5, 0, 255)
    plan = plan_check(MadeUpCamera(), foreign, 0.0)
    assert len(plan.settings) > 2


def test_a_camera_of_one_exposure_only_gives_nothing_to_compare() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), [250, 250])))
    assert [finding.reason for finding in judge_agreement(match, "0012")] == ["nothing_to_compare"]


def solution(response: ResponseFunction) -> ResponseSolution:
    return ResponseSolution(response, "gamma", {}, np.full(256, 0.01), (5, 250), 0.2)


def test_cameras_are_compared_by_what_they_predict() -> None:
    same = compare(solution(GAMMA), solution(GAMMA))
    assert (same.rms_grey, same.worst_grey) == (0.0, 0.0)
    assert "they respond alike" in str(same)
    other = compare(solution(GAMMA), solution(ResponseFunction.linear()))
    assert other.rms_grey > 10
    assert "each needs its own file" in str(other)
