"""Features as the camera enforces them, and acquisition by them, in virtual time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.acquisition import Acquisition, Exposure
from fake_camera.device.faults import Fault
from fake_camera.device.feature_table import ENUM_ENTRIES
from fake_camera.device.features import FeatureError, Features


@pytest.fixture
def features() -> Features:
    features = Features("S1", 720, 540, lambda: 42)
    features.set("ExposureAuto", "Off")
    features.set("GainAuto", "Off")
    return features


def refused(features: Features, name: str, value: int | float | bool | str) -> str:
    with pytest.raises(FeatureError) as error:
        features.set(name, value)
    assert name in str(error.value)
    return error.value.kind


def test_every_initial_value_is_within_its_own_limits(features: Features) -> None:
    for name in features.names:
        spec = features.spec(name)
        if spec.type == "enumeration":
            assert features.get(name) in ENUM_ENTRIES[name]
        elif spec.writable and spec.type in ("integer", "float"):
            limits = features.limits(name)
            assert limits.minimum <= float(features.get(name)) <= limits.maximum, name


@given(value=st.floats(min_value=10, max_value=1e6))
def test_exposure_time_is_rounded_to_the_nearest_increment(value: float) -> None:
    features = Features("S1", 720, 540, lambda: 0)
    features.set("ExposureAuto", "Off")
    features.set("ExposureTime", value)
    taken = float(features.get("ExposureTime"))
    assert taken == int(taken)
    assert abs(taken - value) <= 0.5
    assert 10 <= taken <= 1e6


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ExposureTime", 9.9),
        ("ExposureTime", float("nan")),
        ("Gain", -0.1),
        ("PixelFormat", "YUV444"),
        ("Width", 724),
        ("DeviceUserID", "sixteen letters!"),
    ],
)
def test_out_of_range_is_refused_and_leaves_the_value(features: Features, name: str, value: int | float | str) -> None:
    before = features.get(name)
    assert refused(features, name, value) == "out_of_range"
    assert features.get(name) == before


@pytest.mark.parametrize(("name", "auto", "value"), [("ExposureTime", "ExposureAuto", 50.0), ("Gain", "GainAuto", 3.0)])
def test_auto_functions_lock_what_they_drive(features: Features, name: str, auto: str, value: float) -> None:
    features.set(auto, "Continuous")
    assert features.locked(name)
    assert refused(features, name, value) == "locked"
    features.set(auto, "Once")
    assert features.get(auto) == "Off"
    features.set(name, value)
    assert features.get(name) == value
    features.set("AcquisitionFrameRateEnable", False)
    assert refused(features, "AcquisitionFrameRate", 10.0) == "locked"


@pytest.mark.parametrize(
    ("name", "value"),
    [("Width", 320), ("Height", 400), ("BinningVertical", 2), ("PixelFormat", "Mono12"), ("ChunkModeActive", True)],
)
def test_the_acquisition_locks_the_geometry(features: Features, name: str, value: int | str) -> None:
    features.update("TLParamsLocked", 1)
    assert refused(features, name, value) == "locked"
    features.update("TLParamsLocked", 0)
    features.set(name, value)
    assert features.get(name) == value


def test_the_region_stays_on_the_sensor(features: Features) -> None:
    features.set("Width", 320)
    assert features.limits("OffsetX").maximum == 400
    features.set("OffsetX", 400)
    assert refused(features, "Width", 324) == "out_of_range"
    assert features.limits("Width").maximum == 320


def test_binning_opens_the_region(features: Features) -> None:
    features.set("Height", 400)
    features.set("OffsetY", 100)
    features.set("BinningHorizontal", 2)
    features.set("BinningVertical", 4)
    assert (features.get("WidthMax"), features.get("HeightMax")) == (360, 134)
    assert (features.get("Width"), features.get("Height"), features.get("OffsetY")) == (360, 134, 0)


def test_the_payload_counts_pixels_and_chunks(features: Features) -> None:
    assert features.get("PayloadSize") == 720 * 540
    assert features.get("Timestamp") == 42
    features.set("ChunkEnable", True)
    assert features.enabled_chunks() == ()  # while their mode is off
    features.set("ChunkEnable", False)
    features.set("PixelFormat", "Mono12")
    features.set("ChunkModeActive", True)
    for chunk in ("ExposureTime", "Timestamp"):
        features.set("ChunkSelector", chunk)
        features.set("ChunkEnable", True)
    features.set("ChunkSelector", "Gain")
    assert features.get("ChunkEnable") is False
    assert features.enabled_chunks() == ("ExposureTime", "Timestamp")
    assert features.get("PayloadSize") == 720 * 540 * 2 + 8 + 2 * (8 + 8)


def test_reset_restores_the_power_on_state(features: Features) -> None:
    features.set("Gain", 3.21)
    assert features.get("Gain") == 3.21
    features.set("DeviceUserID", "bow")
    features.set("Gamma", 0.5)
    assert features.image_settings(1 << 62).gamma == 1  # until it is enabled
    features.set("GammaEnable", True)
    assert features.image_settings(1 << 62).gamma == 0.5
    features.reset()
    assert features.get("DeviceUserID") == "bow"  # the user's name outlasts power off
    assert features.get("Gain") == 0
    assert features.get("GainAuto") == "Continuous"
    assert features.image_settings(1 << 62).gain_db == 0


def test_a_user_set_is_kept_over_power_off_and_loaded_as_it_was_saved(features: Features) -> None:
    features.set("Width", 320)
    features.set("LineSelector", "Line3")
    features.set("LineInverter", True)
    assert refused_to(features.save_user_set) == "read_only"  # the default one
    features.set("UserSetSelector", "UserSet0")
    features.save_user_set()
    features.reset()
    assert (features.get("Width"), features.get("LineInverter")) == (720, False)
    features.set("UserSetSelector", "UserSet0")
    features.load_user_set()
    assert (features.get("Width"), features.get("LineSelector"), features.get("LineInverter")) == (320, "Line3", True)
    features.set("UserSetSelector", "Default")
    features.load_user_set()
    assert (features.get("Width"), features.get("ExposureAuto")) == (720, "Continuous")
    features.update("TLParamsLocked", 1)
    assert refused_to(features.load_user_set) == "locked"


def refused_to(command: Callable[[], None]) -> str:
    with pytest.raises(FeatureError) as error:
        command()
    return error.value.kind


def test_balance_ratios_are_kept_by_colour_and_locked_by_the_automatic_balance(features: Features) -> None:
    assert refused_to(lambda: features.set("BalanceRatio", 2.0)) == "locked"
    features.set("BalanceWhiteAuto", "Off")
    features.set("BalanceRatio", 1.5)
    features.set("BalanceRatioSelector", "Blue")
    assert features.get("BalanceRatio") == 1.0
    features.set("BalanceRatio", 1.75)
    assert features.image_settings(1 << 62).balance_ratios == (1.5, 1.0, 1.75)
    assert refused_to(lambda: features.set("BalanceRatio", 4.5)) == "out_of_range"
    features.reset()
    assert features.image_settings(1 << 62).balance_ratios == (1.0, 1.0, 1.0)


MS = 1_000_000
PATIENCE_S = 20.0
SOON_TRIGGERS = 30
NO_FAULTS: frozenset[str] = frozenset()


class Bench:
    """An acquisition at 16 ms per pulse, on a clock that the test sets."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.features = Features("S1", 720, 540, lambda: 0, lambda: self.now_ns)
        self.acquisition = Acquisition(self.features)
        for name in ("ExposureAuto", "GainAuto"):
            self.features.set(name, "Off")

    def await_line0(self, exposure_ms: float, overlap: str) -> None:
        self.features.set("TriggerMode", "On")
        self.features.set("TriggerOverlap", overlap)
        self.features.set("ExposureTime", exposure_ms * 1e3)
        self.acquisition.start(self.now_ns)

    def pulse(self, time_ms: float, number: int = 0, faults: frozenset[str] = NO_FAULTS) -> Exposure | None:
        self.now_ns = round(time_ms * MS)
        return self.acquisition.pulse(number, self.now_ns, faults, wired=True)

    def exposed(self, time_ms: float, number: int = 0, faults: frozenset[str] = NO_FAULTS) -> Exposure:
        exposure = self.pulse(time_ms, number, faults)
        assert exposure is not None
        return exposure

    def free_run_starts_ms(self, count: int) -> list[float]:
        starts = []
        for _ in range(count):
            start_ns = self.acquisition.free_run_start_ns(self.now_ns)
            assert start_ns is not None
            self.acquisition.free_run(start_ns)
            starts.append(start_ns / MS)
        return starts


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_each_pulse_makes_an_exposure_with_its_number_and_time(bench: Bench) -> None:
    bench.await_line0(5.0, "Off")
    exposures = [bench.exposed(16.0 * n, number=n + 7) for n in range(3)]
    assert [(e.frame_id, e.trigger, e.start_ns, e.ready_ns) for e in exposures] == [
        (1, 7, 0, 8 * MS),
        (2, 8, 16 * MS, 24 * MS),
        (3, 9, 32 * MS, 40 * MS),
    ]
    assert bench.acquisition.pulse(0, 48 * MS, NO_FAULTS, wired=False) is None


@pytest.mark.parametrize(
    ("overlap", "second_ms", "taken"),
    [
        ("Off", 4.9, False),  # in the exposure
        ("ReadOut", 4.9, False),
        ("Off", 5.1, False),  # in the readout
        ("ReadOut", 5.1, True),
        ("Off", 8.0, True),
        ("ReadOut", 8.0, True),
    ],
)
def test_a_trigger_in_exposure_or_readout_is_dropped(bench: Bench, overlap: str, second_ms: float, taken: bool) -> None:
    bench.await_line0(5.0, overlap)
    assert bench.pulse(0.0) is not None
    assert (bench.pulse(second_ms) is not None) == taken
    assert bench.acquisition.counters.dropped == (not taken)


def test_readouts_follow_each_other_as_long_as_the_region_is_high_and_no_third_image_waits(bench: Bench) -> None:
    bench.await_line0(0.1, "ReadOut")
    bench.exposed(0.0)
    assert bench.exposed(1.0).ready_ns == 0.1 * MS + 2 * 3 * MS
    assert bench.pulse(2.0) is None
    bench.exposed(3.2)
    bench.acquisition.stop()
    bench.features.set("Height", 180)
    bench.await_line0(5.0, "Off")
    assert bench.exposed(20.0).ready_ns == 26 * MS


def test_a_write_counts_from_its_own_time_on(bench: Bench) -> None:
    bench.await_line0(5.0, "ReadOut")
    first = bench.exposed(0.0)
    bench.now_ns = 2 * MS
    bench.features.set("ExposureTime", 1000.0)
    assert (first.settings.exposure_time_us, first.ready_ns) == (5000, 8 * MS)
    assert bench.exposed(16.0).settings.exposure_time_us == 1000
    bench.now_ns = 32 * MS + 1
    bench.features.set("ExposureTime", 2000.0)
    late = bench.acquisition.pulse(0, 32 * MS, NO_FAULTS, wired=True)  # whose thread comes after the write
    assert late is not None
    assert late.settings.exposure_time_us == 1000


def test_pulses_before_the_start_and_after_the_stop_make_nothing(bench: Bench) -> None:
    bench.now_ns = 10 * MS
    bench.await_line0(1.0, "Off")
    assert bench.features.locked("Width")
    assert bench.acquisition.pulse(0, 9 * MS, NO_FAULTS, wired=True) is None
    bench.exposed(16.0)
    bench.acquisition.stop()
    assert not bench.features.locked("Width")
    assert bench.pulse(32.0) is None
    bench.acquisition.start(bench.now_ns)
    assert bench.exposed(48.0).frame_id == 1


def test_triggers_may_be_ignored_or_halved(bench: Bench) -> None:
    bench.await_line0(1.0, "Off")
    faults = [NO_FAULTS, *[frozenset({Fault.IGNORE_TRIGGERS})] * 2, NO_FAULTS, *[frozenset({Fault.HALVE_TRIGGERS})] * 3]
    exposures = [bench.pulse(16.0 * n, n, each) for n, each in enumerate(faults)]
    assert [e and (e.frame_id, e.trigger) for e in exposures] == [(1, 0), None, None, (2, 3), (3, 4), None, (4, 6)]
    assert bench.acquisition.counters.ignored == 3


def test_a_software_trigger_exposes_only_when_it_is_the_source_and_not_ignored(bench: Bench) -> None:
    bench.await_line0(1.0, "Off")
    assert bench.acquisition.software_trigger(16 * MS) is None
    bench.features.set("TriggerSource", "Software")
    bench.pulse(32.0, faults=frozenset({Fault.IGNORE_TRIGGERS}))
    assert bench.acquisition.software_trigger(33 * MS) is None
    assert bench.acquisition.counters.ignored == 1
    assert bench.pulse(48.0) is None
    exposure = bench.acquisition.software_trigger(49 * MS)
    assert exposure is not None
    assert (exposure.trigger, exposure.frame_id) == (None, 1)


def test_a_frozen_exposure_stays_whatever_is_written(bench: Bench) -> None:
    bench.await_line0(5.0, "ReadOut")
    bench.pulse(0.0)
    bench.features.set("ExposureTime", 1000.0)
    frozen, free = bench.exposed(16.0, faults=frozenset({Fault.FREEZE_EXPOSURE})), bench.exposed(32.0)
    assert frozen.settings.exposure_time_us == 5000
    assert free.settings.exposure_time_us == bench.features.get("ExposureTime") == 1000


def test_runs_free_at_the_frame_rate_or_as_fast_as_the_sensor_goes(bench: Bench) -> None:
    bench.features.set("AcquisitionFrameRate", 50.0)
    bench.acquisition.start(0)
    assert bench.free_run_starts_ms(3) == [0, 20, 40]
    bench.features.set("ExposureTime", 30_000.0)
    assert bench.free_run_starts_ms(3) == [60, 90, 120]
    bench.features.set("TriggerMode", "On")
    bench.now_ns = 500 * MS
    assert bench.acquisition.free_run_start_ns(500 * MS) is None
    bench.features.set("TriggerMode", "Off")
    bench.features.set("AcquisitionFrameRateEnable", False)
    bench.features.set("ExposureTime", 1000.0)
    assert bench.free_run_starts_ms(3) == [500, 503, 506]  # it does not make up for the time it was off


def test_a_single_frame_ends_the_acquisition(bench: Bench) -> None:
    bench.features.set("AcquisitionMode", "SingleFrame")
    bench.acquisition.start(0)
    bench.free_run_starts_ms(1)
    assert bench.acquisition.free_run_start_ns(bench.now_ns) is None
    assert not bench.features.locked("Width")
