"""How the demo starts: what it refuses, which rate it shows, and how it starts its cameras."""

from __future__ import annotations

import os
import re
import signal
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from autoexpose_daemon.demo.fakes import (
    FOLDER_VARIABLE,
    MOST_CAMERAS,
    FakeCamera,
    begin_again_on_fake_bus,
    newest_lux,
    places,
    read_pulses,
    take_signals,
)
from autoexpose_daemon.demo.options import SIZES, DemoOptions, Transport
from autoexpose_daemon.demo.run import run_demo
from autoexpose_daemon.demo.show import configuration, cores, held_rate_hz, rate_notice, sets_per_s
from fake_camera.imaging import ImageSettings, Pixels
from fake_camera.places import names_of_rig
from fake_camera.warm_up import frame_s
from fake_camera.world.sensor import SIZES as simulated_sizes
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.geometry import SIDES
from tests.fakes import loopback_address, unique

LEFT, RIGHT = places(2)
OPTIONS = DemoOptions(20.0, "belief", None, None, "room", None, 0, "gige", None, False, False, None)


class SlowSource:
    """A camera's world that takes its time, by its own clock."""

    sensor_width, sensor_height = 720, 540

    def __init__(self, first_s: float, frame_s: float) -> None:
        self.now_s = 0.0
        self._takes_s = [first_s]
        self._frame_s = frame_s

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        self.now_s += self._takes_s.pop() if self._takes_s else self._frame_s
        return np.zeros((settings.height, settings.width), np.uint8)

    def lux(self, time_s: float) -> float:
        return 1.0

    def clock_s(self) -> float:
        return self.now_s


@pytest.mark.parametrize(
    ("frame_ms", "processors", "rate_hz", "words"),
    [
        (2.0, 2, 60.0, None),
        (12.0, 2, 30.0, "this machine renders 49 frames a second: showing 30 Hz"),
        (2.0, 1, 30.0, "this machine renders 59 frames a second: showing 30 Hz"),
        (17.0, 1, 10.0, "this machine renders 19 frames a second: showing 10 Hz"),
        (400.0, 1, 2.0, "this machine renders 1 frames a second: at 2 Hz the fake cameras will lose some"),
        (32.0, 16, 20.0, "this machine renders 26 frames a second: showing 20 Hz"),
    ],
)
def test_a_slow_simulation_runs_at_a_rate_that_it_sustains(
    frame_ms: float, processors: int, rate_hz: float, words: str | None
) -> None:
    source = SlowSource(1.0, 1e-3 * frame_ms)  # the first frame pays for caches, and does not count
    possible_hz = sets_per_s(frame_s(source, "Mono8", source.clock_s), processors)
    assert held_rate_hz(possible_hz) == rate_hz
    assert rate_notice(possible_hz, rate_hz, asked=False) == words
    assert sets_per_s(0.01, 2, 1440 * 1080 * 2) < 0.8 * sets_per_s(0.01, 2), "larger frames take longer"
    assert sets_per_s(0.01, 2, cameras=6) == pytest.approx(sets_per_s(0.01, 2) / 3), "more cameras do, too"


def test_a_light_script_without_end_is_refused(tmp_path: Path) -> None:
    light = tmp_path / "light.yaml"
    light.write_text("#" * 300_000)
    with pytest.raises(ConfigurationError, match="longer than 256 KiB"):
        replace(OPTIONS, light=light)


def test_the_fake_cameras_have_these_sizes() -> None:
    assert tuple(f"{width}x{height}" for width, height in simulated_sizes) == SIZES


def test_a_requested_rate_is_kept_and_commented_on() -> None:
    assert rate_notice(41.3, 60.0, asked=True) == (
        "this machine renders 41 frames a second: at 60 Hz the fake cameras will lose some"
    )
    assert rate_notice(41.3, 30.0, asked=True) is None


def test_a_container_has_as_many_cores_as_its_quota(tmp_path: Path) -> None:
    allowed = len(os.sched_getaffinity(0))
    quota = tmp_path / "cpu.max"
    for content, expected in (("50000 100000", 0.5), ("max 100000", allowed), ("9999999 1", allowed), ("?", allowed)):
        quota.write_text(content)
        assert cores(quota) == expected
    assert cores(tmp_path / "missing") == allowed


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"seconds": float("inf")}, "--seconds inf is not within 2 to 3600 s"),
        ({"seconds": float("nan")}, "--seconds nan is not within 2 to 3600 s"),
        ({"seconds": 1.0}, "--seconds 1 is not within 2 to 3600 s"),
        ({"rate_hz": float("nan")}, "--rate-hz nan is not within 2 to 200 Hz"),
        ({"rate_hz": 1e300}, "--rate-hz 1e+300 is not within 2 to 200 Hz"),
        ({"seed": 2**64}, f"--seed {2**64} is not within 0 to {2**64 - 1}"),
        ({"seed": -1}, f"--seed -1 is not within 0 to {2**64 - 1}"),
        ({"scene": "/dev/zero"}, "--scene /dev/zero is not a file: name a Radiance .hdr file, or `room`"),
        ({"light": Path("/dev/zero")}, "--light /dev/zero is not a file: name a light script (docs/do/fake-camera.md)"),
        ({"pixel_format": "Mono9"}, "--pixel-format Mono9 is not supported: see docs/look-up/configuration.md"),
        ({"size": "99x99"}, f"--size 99x99 cannot be simulated: give one of {', '.join(SIZES)}"),
        ({"cameras": 0}, "--cameras 0 is not within 1 to 8"),
        ({"cameras": 9}, "--cameras 9 is not within 1 to 8"),
        (
            {"cameras": 4, "bracket": True},
            "--navigate, --bracket and --scene are for a stereo pair: leave them out, or --cameras",
        ),
        ({"plot": Path("/dev")}, "/dev: cannot be written; name a file in an existing folder"),
    ],
)
def test_invalid_options_are_refused_in_a_sentence(change: dict[str, object], sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^{re.escape(sentence)}$"):
        replace(OPTIONS, **change)  # type: ignore[arg-type]


@pytest.mark.wire
def test_a_camera_is_found_then_timed_then_runs_at_the_given_rate(tmp_path: Path) -> None:
    stop = threading.Event()
    camera = FakeCamera(LEFT, tmp_path, ["--address", loopback_address(), "--line0", unique("wire"), "--still"])
    try:
        assert "can_be_found" in camera.line(stop)
        assert "frame_s" in camera.line(stop)
        camera.say("20")
        assert "at 20 Hz" in camera.line(stop)
        while (lux := newest_lux(camera.truth)) is None:
            assert not camera.has_spoken(0.01)
        assert lux == 150.0
        while len(pulses := read_pulses([camera.truth])) < 2:
            assert not camera.has_spoken(0.01)
        assert pulses[1].host_time_ns - pulses[0].host_time_ns == 50_000_000
    finally:
        camera.end()
    assert 0 <= camera.overruns <= len(read_pulses([camera.truth]))  # others keep the machine busy
    assert camera.cpu_s > 0


@pytest.mark.wire
def test_a_camera_that_does_not_start_says_why(tmp_path: Path) -> None:
    camera = FakeCamera(RIGHT, tmp_path, ["--address", loopback_address(), "--line0", unique("wire"), "--still"])
    try:
        camera.line(threading.Event())
        camera.line(threading.Event())
        camera.say("nought")
        with pytest.raises(AutoexposeError, match=r"the right fake camera did not start: .* gave 'nought' as the rate"):
            camera.line(threading.Event())
    finally:
        camera.end()
    assert camera.cpu_s == 0


@pytest.mark.parametrize("transport", ["gige", "usb3"])
def test_on_somebody_elses_usb_bus_the_demo_refuses_and_removes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, transport: Transport
) -> None:
    (tmp_path / "thesis.txt").touch()
    monkeypatch.setenv("FAKE_CAMERA_USB3", f"{tmp_path / 'left'}:{tmp_path / 'right'}")
    with pytest.raises(ConfigurationError, match=r"outside of `python -m fake_camera\.usb3`"):
        run_demo(replace(OPTIONS, transport=transport), threading.Event(), Console())
    assert (tmp_path / "thesis.txt").exists()


def test_ctrl_c_waits_while_the_demo_begins_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopping = {signal.SIGINT, signal.SIGTERM}
    blocked = []
    monkeypatch.setenv(FOLDER_VARIABLE, "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(os, "execv", lambda *_: blocked.append(signal.pthread_sigmask(signal.SIG_BLOCK, ())))
    begin_again_on_fake_bus(2)
    take_signals()
    blocked.append(signal.pthread_sigmask(signal.SIG_BLOCK, ()))
    assert [stopping & signals for signals in blocked] == [stopping, set()]


def test_six_cameras_are_three_pairs_each_exposed_by_its_own_light() -> None:
    config = configuration(replace(OPTIONS, cameras=6), 30.0)
    assert list(config.cameras) == [f"{view}_{side}" for view in ("front", "rear", "port") for side in SIDES]
    assert config.cameras_of_groups == {view: (f"{view}_left", f"{view}_right") for view in ("front", "rear", "port")}
    assert list(configuration(replace(OPTIONS, cameras=1), 30.0).cameras) == ["left"]
    pair = configuration(OPTIONS, 30.0)
    assert list(pair.cameras) == ["left", "right"] and list(pair.cameras_of_groups) == ["all"]


@pytest.mark.parametrize("cameras", range(1, MOST_CAMERAS + 1))
def test_the_fakes_know_the_places_that_the_demo_names_and_gige_vision_takes_their_serials(cameras: int) -> None:
    rig = places(cameras)
    assert [place.name for place in rig] == names_of_rig(cameras)
    assert len({place.serial for place in rig}) == len({place.address for place in rig}) == cameras
    assert max(len(place.serial) for place in rig) <= 15
