"""How much less light reaches a camera, from looks at a made-up wall and over the wire; and that frames then agree."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from autoexpose_daemon.config.load import camera_setup, load_config
from calibration.document import Finding
from calibration.offset import Looks, Offset, judge_looks, judge_offset, look_at_wall, solve_offset
from calibration.session import Session
from calibration.sweep import Shot
from drivers.aravis import open_camera
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.frames import FrameSet
from imaging.pixels import light_samples
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.stereo import running_daemon
from tests.calibration.command_line import done, refused
from tests.calibration.sweeps import gamma, linear, true_response
from tests.fakes import FakeCamera, fake_camera, unique

SHAPE = (40, 60)
LIMITS = ExposureLimits(10.0, 1e6, 0.0, 30.0)
RESPONSES = {linear: ResponseFunction.linear(), gamma: true_response("gamma")}
Curve = Callable[[np.ndarray], np.ndarray]


@dataclass
class Wall:
    """What all cameras look at: its light by the number of frames taken so far, and by the column."""

    light: Callable[[int], float] = lambda frame: 1.0
    tilt_stops: float = 0.0
    frames: int = 0


@dataclass
class WallCamera:
    """A camera that misses some light; 255 at 2 ms of the wall without a filter."""

    wall: Wall
    missing_stops: float = 0.0
    curve: Curve = linear
    limits: ExposureLimits = LIMITS
    black: float = 0.0
    bits: int = 8
    _random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(3))

    def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
        return [self._shot(setting) for _ in range(frames)]

    def _shot(self, setting: ExposureSetting) -> Shot:
        across = np.exp2(np.linspace(-0.5, 0.5, SHAPE[1]) * self.wall.tilt_stops)
        radiance = np.broadcast_to(across, SHAPE) * self.wall.light(self.wall.frames) * 2.0**-self.missing_stops
        self.wall.frames += 1
        seen = self.curve(np.clip(radiance * 2.0 ** (setting.level - math.log2(2000.0)), 0.0, 1.0))
        full = 2**self.bits - 1
        code = (self.black + (1.0 - self.black) * seen) * full + self._random.normal(0.0, full / 200.0, SHAPE)
        dtype = np.uint8 if self.bits == 8 else np.uint16
        return Shot(np.clip(np.rint(code), 0, full).astype(dtype), self.bits, setting, 0.02 * self.wall.frames)


def looked(*cameras: WallCamera) -> list[Looks]:
    """Each camera in turn, and back."""
    there = [look_at_wall(camera, RESPONSES[camera.curve]) for camera in cameras]
    back = [
        look_at_wall(camera, RESPONSES[camera.curve], look.setting)
        for camera, look in reversed([*zip(cameras, there, strict=True)])
    ]
    return [*zip(there, reversed(back), strict=True)]


def measured(missing_stops: float, wall: Wall | None = None, **camera: object) -> Offset:
    wall = wall or Wall()
    plain, filtered = WallCamera(wall), WallCamera(wall, missing_stops, **camera)  # type: ignore[arg-type]
    reference, looks = looked(replace(plain, curve=filtered.curve), filtered)
    assert not [finding for look in (reference, looks) for finding in judge_looks(look) if finding.severity != "warned"]
    return solve_offset(reference, looks)


@pytest.mark.parametrize("missing_stops", [0.0, 2.0, -1.3, 6.5])
@pytest.mark.parametrize("camera", [{}, {"curve": gamma}, {"bits": 12}, {"black": 0.02}])
def test_an_offset_is_recovered_within_the_error_stated(missing_stops: float, camera: dict[str, object]) -> None:
    offset = measured(missing_stops, **camera)
    if "black" in camera:  # which the other camera has not
        assert offset.stops == pytest.approx(missing_stops, abs=0.05)
    else:
        assert abs(offset.stops - missing_stops) <= offset.error_stops < 0.05


def test_another_gain_of_the_reference_counts_as_exposure() -> None:
    offset = measured(1.0, limits=replace(LIMITS, min_gain_db=DB_PER_STOP))
    assert offset.stops == pytest.approx(1.0, abs=offset.error_stops)


def test_light_that_changes_steadily_cancels_and_is_in_the_error() -> None:
    steady, drifting = measured(2.0), measured(2.0, Wall(lambda frame: 1.0 + 1e-3 * frame))
    assert steady.error_stops < drifting.error_stops
    assert abs(drifting.stops - 2.0) <= drifting.error_stops


@pytest.mark.parametrize(
    ("camera", "wall", "reason"),
    [
        ({"limits": ExposureLimits(10.0, 50.0, 0.0, 30.0)}, {}, "too_dark"),
        ({"limits": ExposureLimits(9000.0, 1e6, 0.0, 30.0)}, {}, "clipped"),
        ({"missing_stops": 40.0}, {}, "too_dark"),
        ({}, {"light": lambda frame: 1.0 + 0.2 * (frame % 2)}, "unsteady"),
        ({}, {"light": lambda frame: 1.0 if frame < 22 else 1.3}, "unsteady"),
        ({}, {"tilt_stops": 2.0}, "uneven"),
    ],
)
def test_what_says_nothing_is_refused(camera: dict[str, object], wall: dict[str, object], reason: str) -> None:
    seen = Wall(**wall)  # type: ignore[arg-type]
    (_, looks) = looked(WallCamera(seen), WallCamera(seen, **camera))  # type: ignore[arg-type]
    assert refusals(judge_looks(looks)) == [reason]


def test_what_no_camera_can_make_up_for_is_refused() -> None:
    assert refusals(judge_offset(Offset(8.2, 0.02), True)) == ["out_of_range"]
    assert refusals(judge_offset(Offset(2.0, 0.02), False)) == ["no_gain"]
    assert refusals(judge_offset(Offset(-8.0, 0.02), True)) == []


def refusals(findings: Iterator[Finding]) -> list[str]:
    return [finding.reason for finding in findings if finding.severity == "refused"]


def stops_apart(one: float, other: float) -> float:
    return abs(math.log2(one / other))


@contextmanager
def filtered_rig(folder: Path) -> Iterator[tuple[FakeCamera, FakeCamera, list[Path]]]:
    """Two fakes before one wall, the lens of the right one two stops slower."""
    light = folder / "light.yaml"
    light.write_text("light: [{at_s: 0, lux: 300}]")
    wire, truths = unique("wire"), [folder / "left.jsonl", folder / "right.jsonl"]
    with ExitStack() as stack:
        left, right = (
            stack.enter_context(fake_camera(unique(f"OFF{side[0].upper()}")[:15], side=side, line0=wire, options=[
                "--scene", "wall", "--light", str(light), "--lens-f-number", f_number, "--truth", str(truth)
            ]))
            for side, f_number, truth in zip(("left", "right"), ("0.9", "1.8"), truths, strict=True)
        )  # fmt: skip
        yield left, right, truths


@pytest.mark.wire
def test_a_filter_of_two_stops_is_found_and_frames_agree_with_what_is_pasted(tmp_path: Path) -> None:
    rig, pasted = tmp_path / "rig.yaml", tmp_path / "offsets.yaml"
    with filtered_rig(tmp_path) as (left, right, _):
        serials = {"left": {"serial": left.serial}, "right": {"serial": right.serial, "offset_stops": 5.0}}
        rig.write_text(yaml.safe_dump({"cameras": serials}))  # an offset that is there does not count
        assert done("offset", "-c", str(rig), "-o", str(pasted)).count("verdict: believe it") == 2
        found = yaml.safe_load(pasted.read_text())["cameras"]
        assert found["left"] == {"serial": left.serial, "offset_stops": 0.0}
        assert found["right"] == {"serial": right.serial, "offset_stops": pytest.approx(2.0, abs=0.05)}
        by_right = done("offset", "-c", str(rig), "--reference", "right")
        sections = yaml.safe_load(by_right[by_right.index("cameras:") :])["cameras"]
        assert sections["left"]["offset_stops"] == pytest.approx(-2.0, abs=0.05)
        assert sections["right"]["offset_stops"] == 0.0
        config = load_config(pasted)
        for setting in (ExposureSetting(1000.0, 0.0), ExposureSetting(300.0, 6.0)):
            light = []
            for name, camera in config.cameras.items():
                setup = replace(
                    camera_setup(config, name), trigger=replace(camera_setup(config, name).trigger, mode="free_run")
                )
                with Session(open_camera(camera.serial, setup), light_samples) as session:
                    (shot,) = session.take(setting, 1)
                assert shot.setting.agrees_with(setting)
                light.append(float(shot.pixels.mean()))
            assert stops_apart(*light) < 0.1
        assert "name a new file" in refused("offset", "-c", str(rig), "-o", str(pasted))
        assert "--reference middle: the cameras are left, right" in refused(
            "offset", "-c", str(rig), "--reference", "middle"
        )
        assert "only left is given" in refused("offset", "--camera", left.serial)


@pytest.mark.realtime
def test_the_frames_of_a_running_rig_agree(tmp_path: Path) -> None:
    with filtered_rig(tmp_path) as cameras:
        left, right, _ = cameras
        rig = {"left": {"serial": left.serial}, "right": {"serial": right.serial, "offset_stops": 2.0}}
        with running_daemon(cameras, {"cameras": rig, "control": {"policy": "neves2009"}}) as run:

            def agree(pair: FrameSet) -> bool:
                one, other = (frame.pixels.mean() for frame in pair.frames.values())
                return not pair.mismatched and abs(one / 255 - 0.2) < 0.05 and stops_apart(one, other) < 0.1

            run.wait_until(
                lambda: len(run.seen) > 20 and all(len(pair.frames) == 2 and agree(pair) for pair, _ in run.seen[-20:]),
                "frames as bright as asked for and as each other",
            )
            counts = run.daemon.telemetry.counts
            assert (counts.adjusted_writes, counts.unexplained_mismatches) == (0, 0)
