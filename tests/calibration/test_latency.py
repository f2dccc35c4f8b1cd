"""The latency of a camera: what trials say, and trials in virtual time on a camera that does as the test says."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration import latency as trials_module
from calibration import session as session_module
from calibration.latency import TrialFrame, WriteEffect, WriteTrial, capture_latency, write_effect
from calibration.session import Session
from drivers.camera import CameraDescription
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, SettingSource

FRAME_NS = 16_000_000
OLD, NEW = 100.0, 50.0


def trial(latency: int, *, lead_ns: int = 2_000_000, took_ns: int = 500_000, told: int | None = None) -> WriteTrial:
    """Frames 10 to 20; the write comes in the exposure of frame 12 and shows `latency` frames later."""
    frames = tuple(
        TrialFrame(
            number,
            number * FRAME_NS,
            NEW if number - 12 >= latency else OLD,
            None if told is None else number - 12 >= told,
        )
        for number in range(10, 21)
    )
    return WriteTrial(12 * FRAME_NS + lead_ns, 12 * FRAME_NS + lead_ns + took_ns, frames)


@pytest.mark.parametrize("latency", [1, 2, 3])
def test_a_steady_camera_has_one_latency(latency: int) -> None:
    effect = write_effect("exposure", [trial(latency)] * 20)
    assert effect.frames == {latency: 20}
    assert (effect.mode, effect.unclear, effect.findings) == (latency, 0, ())
    assert effect.lead_us == pytest.approx(2500.0)
    assert effect.delay_us == pytest.approx((latency * 16_000 - 18_500.0, latency * 16_000 - 2500.0))


@given(st.dictionaries(st.integers(1, 4), st.integers(1, 40), min_size=1), st.integers(0, 2**32 - 1))
def test_the_histogram_counts_every_write(counts: dict[int, int], seed: int) -> None:
    trials = [trial(latency) for latency, count in counts.items() for _ in range(count)]
    random.Random(seed).shuffle(trials)
    effect = write_effect("gain", trials)
    assert effect.frames == dict(sorted(counts.items()))
    assert counts[effect.mode or 0] == max(counts.values())
    reasons = {finding.reason for finding in effect.findings}
    assert ("too_few_writes" in reasons) == (len(trials) < 5)
    assert ("irregular" in reasons) == (len(trials) >= 5 and max(counts.values()) < 0.95 * len(trials))


def test_an_irregular_camera_is_clear_with_its_histogram() -> None:
    (finding,) = write_effect("gain", [trial(1)] * 15 + [trial(2)] * 5).findings
    assert (finding.severity, finding.reason) == ("warned", "irregular")
    assert "(15 times 1, 5 times 2)" in finding.text


def without(spoilt: WriteTrial, frame_id: int) -> WriteTrial:
    return replace(spoilt, frames=tuple(frame for frame in spoilt.frames if frame.frame_id != frame_id))


def torn(spoilt: WriteTrial) -> WriteTrial:
    """Time and gain did not change together: one frame lies between old and new."""
    frames = (replace(frame, grey=75.0) if frame.frame_id == 13 else frame for frame in spoilt.frames)
    return replace(spoilt, frames=tuple(frames))


@pytest.mark.parametrize(
    "unclear",
    [
        trial(2, lead_ns=15_800_000),
        trial(20),
        trial(0),
        without(trial(2), 13),
        without(trial(2), 14),
        torn(trial(1)),
        replace(trial(1), frames=trial(1).frames[:3]),
        replace(trial(1), frames=trial(1).frames[3:]),
        WriteTrial(0, 1, ()),
    ],
    ids=[
        "met by two exposures",
        "no effect",
        "before the write",
        "lost",
        "lost",
        "torn",
        "cut",
        "no before",
        "nothing",
    ],
)
def test_writes_that_are_unclear_are_counted_apart(unclear: WriteTrial) -> None:
    effect = write_effect("exposure", [trial(2)] * 10 + [unclear] * 3)
    assert (effect.frames, effect.unclear) == ({2: 10}, 3)
    assert [finding.reason for finding in effect.findings] == ["unclear"]


def test_frames_that_claim_a_setting_too_early_are_told() -> None:
    assert write_effect("exposure", [trial(2, told=2)] * 10).findings == ()
    (finding,) = write_effect("exposure", [trial(2, told=1)] * 10).findings
    assert finding.reason == "metadata_off"
    assert "claim a new exposure 1 frames after its write, but show it after 2" in finding.text


def test_a_write_whose_effect_goes_away_again_is_not_told() -> None:
    """A lamp flickered, or something else wrote."""
    gone = trial(2)
    blinking = replace(
        gone, frames=tuple(replace(frame, grey=OLD) if frame.frame_id == 16 else frame for frame in gone.frames)
    )
    assert write_effect("exposure", [trial(2)] * 10 + [blinking] * 3).unclear == 3


RATE_HZ = 50.0
PERIOD_NS = round(1e9 / RATE_HZ)
READOUT_NS = 3_000_000
WRITE_NS = 400_000
GREY_AT_LEVEL = 18.0
"""Exposure level (stops) at which this scene is saturated."""


@dataclass
class VirtualCamera:
    """Latches `latency()` frames after a write, in virtual time; also stands in for the module `time`."""

    latency: Callable[[], int]
    limits: ExposureLimits = field(default_factory=lambda: ExposureLimits(10.0, 1e5, 0.0, 24.0))
    source: SettingSource = "chunk"
    stamps_are_arrivals: bool = False
    light: float = 1.0
    write_ns: Callable[[], int] = lambda: WRITE_NS
    description: CameraDescription = field(default_factory=lambda: CameraDescription("ours", "virtual", "V"))
    now_ns: int = 10**9
    number: int = 0
    latched: dict[int, ExposureSetting] = field(default_factory=lambda: {0: ExposureSetting(1000.0, 0.0)})

    def monotonic_ns(self) -> int:
        return self.now_ns

    def monotonic(self) -> float:
        return self.now_ns * 1e-9

    def start(self) -> None: ...

    def latch_clock(self) -> None: ...

    def close(self) -> None: ...

    def setting_of(self, number: int) -> ExposureSetting:
        return self.latched[max(first for first in self.latched if first <= number)]

    def next_frame(self, timeout_s: float) -> Frame | None:
        number, setting = self.number + 1, self.setting_of(self.number + 1)
        start_ns = number * PERIOD_NS
        arrival_ns = start_ns + round(setting.exposure_time_us * 1e3) + READOUT_NS
        deadline_ns = self.now_ns + round(timeout_s * 1e9)
        if arrival_ns > deadline_ns:
            self.now_ns = deadline_ns
            return None
        self.number, self.now_ns = number, max(self.now_ns, arrival_ns)
        grey = min(255.0 * 2.0 ** (setting.level - GREY_AT_LEVEL) * self.light, 255.0)
        pixels = np.full((8, 8), round(grey), np.uint8)
        stamp_ns = arrival_ns if self.stamps_are_arrivals else start_ns
        told = setting if self.source == "chunk" else self.latched[max(self.latched)]
        return Frame(pixels, 8, number, stamp_ns, stamp_ns, arrival_ns, told, self.source)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        self.now_ns += self.write_ns()
        self.latched[self.now_ns // PERIOD_NS + self.latency()] = setting
        return setting


Measure = Callable[[VirtualCamera], list[WriteEffect]]


@pytest.fixture
def measure(monkeypatch: pytest.MonkeyPatch) -> Measure:
    def run(camera: VirtualCamera) -> list[WriteEffect]:
        for module in (session_module, trials_module):
            monkeypatch.setattr(module, "time", camera)
        with Session(camera) as session:
            return capture_latency(session, RATE_HZ, 20, lambda done, total: None)

    return run


@pytest.mark.parametrize("latency", [1, 2, 3])
@pytest.mark.parametrize("source", ["chunk", "ledger"])
def test_latency_is_that_of_the_camera(measure: Measure, latency: int, source: SettingSource) -> None:
    effects = measure(VirtualCamera(lambda: latency, source=source))
    assert [effect.quantity for effect in effects] == ["exposure", "gain"]
    for effect in effects:
        assert effect.frames == {latency: 20}
        assert effect.findings == ()
        assert effect.lead_us == pytest.approx(0.1 * PERIOD_NS * 1e-3 + WRITE_NS * 1e-3, rel=0.2), "just after a start"


def test_writes_that_a_busy_computer_spoils_are_made_again(measure: Measure) -> None:
    camera = VirtualCamera(lambda: 1)
    times_ns = itertools.cycle([WRITE_NS, WRITE_NS, PERIOD_NS])
    camera.write_ns = lambda: next(times_ns)
    exposure, gain = measure(camera)
    for effect in (exposure, gain):
        assert effect.frames == {1: 20}
        assert effect.unclear > 5
        assert [finding.reason for finding in effect.findings] == ["unclear"]


def test_stamps_that_tell_the_arrival_do_not_add_a_frame(measure: Measure) -> None:
    exposure, _ = measure(VirtualCamera(lambda: 1, stamps_are_arrivals=True))
    assert exposure.mode == 1


def test_a_camera_without_gain_is_measured_by_its_exposure_alone(measure: Measure) -> None:
    effects = measure(VirtualCamera(lambda: 2, ExposureLimits(10.0, 1e5, 0.0, 0.0), light=16.0))
    assert [(effect.quantity, effect.mode) for effect in effects] == [("exposure", 2)]


@pytest.mark.parametrize(("light", "reason"), [(1e-4, "too_dark"), (1e6, "too_bright")])
def test_a_scene_that_tells_nothing_is_refused(measure: Measure, light: float, reason: str) -> None:
    for effect in measure(VirtualCamera(lambda: 1, light=light)):
        assert [(finding.severity, finding.reason) for finding in effect.findings] == [("refused", reason)]
        assert effect.mode is None


@pytest.mark.parametrize(("most_db", "told"), [(2.0, ["exposure"]), (4.0, ["exposure", "gain"])])
def test_a_gain_is_measured_where_it_has_half_a_stop_to_show(measure: Measure, most_db: float, told: list[str]) -> None:
    effects = measure(VirtualCamera(lambda: 1, ExposureLimits(10.0, 1e5, 0.0, most_db), light=4.0))
    assert [effect.quantity for effect in effects] == told


def test_a_computer_that_spoils_every_write_is_given_up_after_twice_as_many(measure: Measure) -> None:
    camera = VirtualCamera(lambda: 1)
    camera.write_ns = lambda: 2 * PERIOD_NS
    for effect in measure(camera):
        assert (effect.mode, effect.unclear) == (None, 40)
        assert [finding.reason for finding in effect.findings] == ["too_few_writes"]
