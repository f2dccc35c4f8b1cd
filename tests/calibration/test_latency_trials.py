"""The latency of a camera in virtual time, which does as the test says."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from calibration import latency as trials_module
from calibration import session as session_module
from calibration.latency import WriteEffect, capture_latency
from calibration.session import Session
from drivers.camera import CameraDescription
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, SettingSource

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
def calls() -> list[tuple[int, int]]:
    """What the progress was told."""
    return []


@pytest.fixture
def measure(monkeypatch: pytest.MonkeyPatch, calls: list[tuple[int, int]]) -> Measure:
    def run(camera: VirtualCamera) -> list[WriteEffect]:
        for module in (session_module, trials_module):
            monkeypatch.setattr(module, "time", camera)
        with Session(camera) as session:
            return capture_latency(session, RATE_HZ, 20, lambda done, total: calls.append((done, total)))

    return run


@pytest.mark.parametrize("latency", [1, 2, 3])
@pytest.mark.parametrize("source", ["chunk", "ledger"])
def test_latency_is_that_of_the_camera(measure: Measure, latency: int, source: SettingSource) -> None:
    effects = measure(VirtualCamera(lambda: latency, source=source))
    assert [effect.quantity for effect in effects] == ["exposure", "gain"]
    for effect in effects:
        assert effect.frames == {latency: 20}
        assert effect.findings == ()
        assert effect.lead_us is not None
        assert effect.lead_us == pytest.approx(0.1 * PERIOD_NS * 1e-3 + WRITE_NS * 1e-3, rel=0.2), "just after a start"


def test_progress_counts_the_writes_of_both(measure: Measure, calls: list[tuple[int, int]]) -> None:
    measure(VirtualCamera(lambda: 1))
    assert calls == [(done, 40) for done in range(1, 41)]


def test_writes_that_a_busy_computer_spoils_are_made_again(measure: Measure) -> None:
    camera = VirtualCamera(lambda: 1)
    times_ns = itertools.cycle([WRITE_NS, WRITE_NS, PERIOD_NS])
    camera.write_ns = lambda: next(times_ns)
    exposure, gain = measure(camera)
    for effect in (exposure, gain):
        assert effect.frames == {1: 20}
        assert effect.unclear > 5
        assert [finding.reason for finding in effect.findings] == ["unclear"]


def test_an_irregular_camera_shows_as_it_is(measure: Measure) -> None:
    numbers = random.Random(2)
    effects = measure(VirtualCamera(lambda: 1 if numbers.random() < 0.7 else 2))
    for effect in effects:
        assert effect.mode == 1
        assert set(effect.frames) == {1, 2}
        assert [finding.reason for finding in effect.findings] == ["irregular"]


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
