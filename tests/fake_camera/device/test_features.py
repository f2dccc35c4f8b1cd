"""The features: limits, increments and locks as the camera enforces them, and settings as of a moment."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.feature_table import ENUM_ENTRIES
from fake_camera.device.features import FeatureError, Features


class HostClock:
    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


@pytest.fixture
def clock() -> HostClock:
    return HostClock()


@pytest.fixture
def features(clock: HostClock) -> Features:
    features = Features("S1", 720, 540, lambda: 42, clock)
    features.set("ExposureAuto", "Off")
    features.set("GainAuto", "Off")
    return features


def refused(features: Features, name: str, value: int | float | bool | str) -> str:
    with pytest.raises(FeatureError) as error:
        features.set(name, value)
    assert name in str(error.value)
    return error.value.kind


def test_powers_on_free_running_with_auto_functions_on() -> None:
    features = Features("S1", 720, 540, lambda: 0)
    on = {name: features.get(name) for name in ("TriggerMode", "ExposureAuto", "GainAuto", "PixelFormat", "Width")}
    assert on == {
        "TriggerMode": "Off",
        "ExposureAuto": "Continuous",
        "GainAuto": "Continuous",
        "PixelFormat": "Mono8",
        "Width": 720,
    }
    assert features.get("DeviceSerialNumber") == "S1"


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
        ("ExposureTime", 1_000_001.0),
        ("ExposureTime", float("nan")),
        ("Gain", -0.1),
        ("Gain", 47.1),
        ("PixelFormat", "YUV444"),
        ("Width", 724),
        ("Width", 0),
        ("DeviceUserID", "sixteen letters!"),
    ],
)
def test_out_of_range_is_refused_and_leaves_the_value(features: Features, name: str, value: int | float | str) -> None:
    before = features.get(name)
    assert refused(features, name, value) == "out_of_range"
    assert features.get(name) == before


@pytest.mark.parametrize("name", ["DeviceSerialNumber", "SensorWidth", "PayloadSize", "Timestamp"])
def test_read_only(features: Features, name: str) -> None:
    assert refused(features, name, 1) == "read_only"


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


def test_a_write_counts_from_its_own_time_on(features: Features, clock: HostClock) -> None:
    clock.now_ns = 1000
    features.set("ExposureTime", 100.0)
    clock.now_ns = 2000
    features.set("ExposureTime", 200.0)
    seen = [features.image_settings(at_ns).exposure_time_us for at_ns in (999, 1000, 1999, 2000, 9999)]
    assert seen == [5000, 100, 100, 200, 200]


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
    assert features.image_settings(10**12).gain_db == 0


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
