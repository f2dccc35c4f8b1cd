"""Cameras in groups: each group is decided on, written and asked by itself."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.request import new_request
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.runtime.group_control import starts
from autoexpose_daemon.runtime.rig_control import RigControl
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.status.counters import Answer
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from drivers.camera import CameraDescription
from drivers.rig.events import CameraReady, CameraSilent, Command, FrameArrived, WriteFailed, Written
from drivers.rig.supervision import Slots
from imaging.errors import ConfigurationError, NodeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame
from imaging.pixels import PixelFormat

PERIOD_NS = 20_000_000
GROUPS: dict[CameraName, str] = {"left": "front", "right": "front", "back": "rear"}
DARK, MIDDLE, BRIGHT = 20, 51, 110
"""Grey levels; the middle one is what the policy aims at."""


def config(**sections: Any) -> Config:
    cameras = {name: {"serial": name, "group": group} for name, group in GROUPS.items()}
    common = {"trigger": {"rate_hz": 50}, "control": {"policy": "neves2009"}}
    return Config.model_validate({"cameras": cameras} | common | sections)


class Rig:
    """Control of three cameras in two groups, which have written what they were asked for at once."""

    def __init__(self, **sections: Any) -> None:
        self.config = config(**sections)
        self.now_ns = 0
        self.trigger = 0
        self.commands: list[Command] = []
        self.steps: list[ControlStep] = []
        self.settings = starts(self.config)
        self.control = RigControl(self.config, self, now_ns=lambda: self.now_ns)
        self.control.outlets.append(self.steps.append)
        self.control.take([self._ready(camera) for camera in self.config.cameras])
        self.control.take([Written(camera, it, it, 0, 1) for camera, it in self.settings.items()])

    def write(self, command: Command) -> None:
        self.commands.append(command)

    def pace(self, camera: CameraName, slots: Slots) -> None:
        raise AssertionError("triggered from outside")

    def reopen(self, camera: CameraName, why: str) -> None:
        raise AssertionError("not silent for long")

    def pulse(self, **greys: int) -> None:
        """A trigger that some cameras show; then what was asked for is written."""
        self.trigger += 1
        self.now_ns = self.trigger * PERIOD_NS + PERIOD_NS // 4
        before = len(self.commands)
        self.control.take([self._arrived(camera, grey) for camera, grey in greys.items()])
        for command in self.commands[before:]:
            for camera in command.cameras:
                self.settings[camera] = command.setting
                times_ns = (self.now_ns, self.now_ns + 1)
                self.control.take([Written(camera, command.setting, command.setting, *times_ns, command.number)])

    def ask(self, **changes: Any) -> Answer:
        answer: Future[Answer] = Future()
        self.control.ask(new_request({"by": "test"} | changes), answer)
        return answer.result(0.0)

    @property
    def status(self) -> Status:
        found = Status.from_json(describe(self.control.telemetry, self.control.config).to_json())
        assert found is not None
        return found

    def _arrived(self, camera: CameraName, grey: int) -> FrameArrived:
        pixels, time_ns = np.full((68, 90), grey, np.uint8), self.trigger * PERIOD_NS
        return FrameArrived(
            camera, Frame(pixels, 8, self.trigger, time_ns, time_ns, self.now_ns, self.settings[camera])
        )

    @staticmethod
    def _ready(camera: CameraName) -> CameraReady:
        about = CameraDescription("ours", "scripted", camera, pixel_format=PixelFormat.MONO8, size=(90, 68))
        return CameraReady(camera, about, ExposureLimits(20.0, 15_000.0, 0.0, 30.0))


ALL = dict.fromkeys(GROUPS, MIDDLE)


@pytest.mark.parametrize("policy", ["belief", "neves2009"])
def test_a_group_is_exposed_as_it_would_be_alone(policy: str) -> None:
    together = Rig(control={"policy": policy})
    alone = Rig(control={"policy": policy}, cameras={"back": {"serial": "back"}})
    first = alone.settings["back"]
    for _ in range(25):
        greys = {camera: grey_in(0.02, together.settings[camera]) for camera in ("left", "right")}
        together.pulse(**greys, back=grey_in(0.4, together.settings["back"]))  # 4.3 stops more: in the sun
        alone.pulse(back=grey_in(0.4, alone.settings["back"]))
        assert together.settings["back"] == alone.settings["back"]
    assert together.settings["left"].level > alone.settings["back"].level + 3.0
    assert alone.settings["back"] != first


def grey_in(light: float, setting: ExposureSetting) -> int:
    """What a linear camera makes of a light, in grey levels for each microsecond at 0 dB."""
    return int(min(light * 2.0**setting.level, 255.0))


def test_each_group_is_exposed_for_its_own_light() -> None:
    rig = Rig()
    for _ in range(3):
        rig.pulse(left=DARK, right=DARK, back=BRIGHT)
    front, rear = rig.settings["left"], rig.settings["back"]
    assert front == rig.settings["right"]
    assert front.level > rig.config.start.level + 0.5 > rear.level + 1.0
    assert {command.cameras for command in rig.commands} == {("left", "right"), ("back",)}
    numbers = [command.number for command in rig.commands]
    assert numbers == list(range(1, len(numbers) + 1))
    step = rig.steps[-1]
    assert set(step.groups) == {"front", "rear"} and set(step.pair.frames) == set(GROUPS)
    assert {camera: decision.setting for camera, decision in step.decisions.items()} == rig.settings
    assert step.decision == step.groups["front"].decision
    assert rig.control.telemetry.counts.mismatched_pairs == 0


def test_a_group_whose_cameras_send_nothing_is_left_as_it_is_and_the_other_goes_on() -> None:
    rig = Rig()
    for _ in range(3):
        rig.pulse(**ALL)
    known = rig.settings["back"]
    rig.steps.clear()
    rig.control.take([CameraSilent("back")])
    for _ in range(3):
        rig.pulse(left=BRIGHT, right=BRIGHT)
    assert [list(step.groups) for step in rig.steps] == [["front"]] * 3
    assert rig.settings["back"] == known and rig.settings["left"].level < known.level - 0.5
    assert all(command.cameras != ("back",) for command in rig.commands[-3:])
    rig.pulse(**ALL)
    assert set(rig.steps[-1].groups) == {"front", "rear"}


def test_a_group_of_two_goes_on_with_one_of_them() -> None:
    rig = Rig()
    rig.pulse(**ALL)
    rig.control.take([CameraSilent("left")])
    for _ in range(3):
        rig.pulse(right=DARK, back=MIDDLE)
    assert rig.commands[-1].cameras == ("left", "right")
    assert rig.settings["right"].level > rig.settings["back"].level + 0.5


def test_a_group_starts_within_its_own_bounds_and_stays_there() -> None:
    rig = Rig(
        groups={"rear": {"exposure": {"max_time_us": 1500, "max_gain_db": 0}, "start": {"exposure_time_us": 900}}}
    )
    assert rig.settings == {"left": rig.config.start, "right": rig.config.start, "back": ExposureSetting(900.0, 0.0)}
    remembered = starts(rig.config, ExposureSetting(5000.0, 0.0))
    assert remembered["left"] == ExposureSetting(5000.0, 0.0)
    assert remembered["back"].exposure_time_us == pytest.approx(1500.0)
    for _ in range(5):
        rig.pulse(**dict.fromkeys(GROUPS, DARK))
    assert rig.settings["back"].agrees_with(ExposureSetting(1500.0, 0.0))
    assert rig.settings["left"].level > rig.settings["back"].level


def test_a_write_that_failed_is_made_again_for_its_group_alone() -> None:
    rig = Rig(control={"policy": "fixed"})
    rig.pulse(**ALL)
    assert rig.commands == []
    rig.control.take([WriteFailed("back", rig.settings["back"], NodeError("refused"))])
    rig.pulse(**ALL)
    assert [command.cameras for command in rig.commands] == [("back",)]


def test_a_request_is_for_all_groups_or_the_one_that_it_names() -> None:
    rig = Rig(control={"policy": "fixed"})
    rig.pulse(**ALL)
    rig.ask(ev_stops=-1.0)
    rig.pulse(**ALL)
    assert {round(setting.level - rig.config.start.level, 2) for setting in rig.settings.values()} == {-1.0}
    rig.ask(group="rear", ev_stops=1.0)
    rig.pulse(**ALL)
    rises = {camera: round(setting.level - rig.config.start.level, 2) for camera, setting in rig.settings.items()}
    assert rises == {"left": -1.0, "right": -1.0, "back": 1.0}
    answer = rig.ask(group="rear", policy="neves2009", locked=True)
    assert answer.policy == "neves2009" and answer.requests.locked == rig.settings["back"]
    rig.pulse(left=BRIGHT, right=BRIGHT, back=BRIGHT)
    groups = rig.status.groups
    assert {name: group.policy for name, group in groups.items()} == {"front": "fixed", "rear": "neves2009"}
    assert groups["front"].requests.locked is None and groups["rear"].requests.locked == rig.settings["back"]
    assert {name: group.cameras for name, group in groups.items()} == {"front": ("left", "right"), "rear": ("back",)}


def test_a_region_is_a_matter_of_the_group_that_has_the_camera() -> None:
    rig = Rig()
    rig.pulse(**ALL)
    rig.ask(region={"back": {"rectangles": [{"box": (0, 0, 40, 40)}]}})
    groups = rig.status.groups
    assert (groups["front"].requests.changed, groups["rear"].requests.changed) == ((), ("region back",))
    rig.ask(reset=True)
    assert rig.status.groups["rear"].requests.changed == ()


def test_a_shot_is_of_one_group() -> None:
    rig = Rig(control={"policy": "fixed"})
    rig.pulse(**ALL)
    answer: Future[Answer] = Future()
    shot = {"exposure_time_us": 300.0}
    rig.control.ask(new_request({"by": "test", "group": "rear", "shot": shot}), answer)
    rig.pulse(**ALL)
    assert (rig.settings["back"].exposure_time_us, rig.settings["left"]) == (300.0, rig.config.start)
    rig.pulse(**ALL)
    found = answer.result(0.0).shot
    assert found is not None and set(found.frame_ids) == {"back"}
    assert rig.settings["back"] == rig.config.start


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"group": "top", "ev_stops": 1.0}, "there is no group top: give one of front, rear"),
        ({"shot": {"exposure_time_us": 300.0}}, "a shot is of one group: give group, one of front, rear"),
        ({"region": {"top": {}}}, "region.top: the rig has no top camera"),
        ({"group": "front", "region": {"back": {}}}, "region.back: that camera is not in group front"),
        ({"limits": {"min_time_us": 2000.0}}, "2000"),  # the group at the rear may not expose for so long
    ],
)
def test_what_one_group_refuses_is_taken_by_none(changes: dict[str, Any], words: str) -> None:
    rig = Rig(groups={"rear": {"exposure": {"max_time_us": 1500}, "start": {"exposure_time_us": 900}}})
    rig.pulse(**ALL)
    before = rig.status.groups
    with pytest.raises(ConfigurationError) as refused:
        rig.ask(**changes)
    assert words in str(refused.value)
    after = rig.status.groups
    assert {name: group.requests.bounds for name, group in after.items()} == {
        name: group.requests.bounds for name, group in before.items()
    }
    assert all(not group.requests.changed and not group.requests.taken for group in after.values())
    assert sum(group.requests.refused for group in after.values()) == 1


def test_a_reload_gives_each_group_its_new_tuning() -> None:
    rig = Rig()
    rig.pulse(**ALL)
    rig.ask(ev_stops=1.0)
    rig.control.tune(Tuning(config(groups={"rear": {"policy": "fixed", "start": {"exposure_time_us": 700}}})))
    rig.pulse(**ALL)
    assert {name: group.policy for name, group in rig.status.groups.items()} == {"front": "neves2009", "rear": "fixed"}
    assert rig.settings["back"].agrees_with(ExposureSetting(700.0, 0.0))
    assert all(group.requests.ev_stops == 0.0 for group in rig.status.groups.values())


def test_a_status_without_groups_of_an_earlier_daemon_is_read() -> None:
    status = Rig().status
    assert Status.from_json(replace(status, groups={}).to_json()) == replace(status, groups={})
