"""Runs of control in virtual time, recorded as a daemon would."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import NDArray

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.inputs import CELLS, LightAhead
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.picture.steering import Steering
from autoexpose_daemon.control.step import NO_OVERRIDE, ControlStep, Override, StepInputs
from autoexpose_daemon.recording.read import Recording
from autoexpose_daemon.recording.recorder import ContinuousRecorder, Recorder
from autoexpose_daemon.recording.replay import Replay, Replayed
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting
from tests.autoexpose_daemon.control.scene import FRAME_NS, expose, radiance

LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0, 1.0)
START = ExposureSetting(1000.0, 0.0)
SHAPE = (136, 180)


@dataclass
class VirtualRun:
    """A loop, the light it lives in, and what it has decided."""

    policy_id: str = "belief"
    bits: int = 8
    imu: bool = False
    driven_before: bool = False
    steered: bool = False
    vignettings: dict[CameraName, Vignetting] = field(default_factory=dict)
    tracked: bool = False
    loop: ControlLoop = field(init=False)
    decisions: dict[int, Decision] = field(default_factory=dict)
    trigger: int = 99

    def __post_init__(self) -> None:
        parameters = ControlParameters(focal_length_px=800.0 if self.imu else None)
        self.loop = ControlLoop(
            self.policy_id, ResponseFunction.linear(), LIMITS, START, parameters, vignettings=self.vignettings
        )
        self._scenes = radiance(1, 1.2, SHAPE), radiance(2, 0.8, SHAPE)
        self._rng = np.random.default_rng(5)
        self._light = 13.0
        self._settings = [START, START]

    def pairs(self) -> Iterator[FrameSet]:
        """One pair after another, each taken with the decision on the pair before the last."""
        while True:
            self.trigger += 1
            self._light += float(self._rng.choice([0.0, 0.0, 0.1, self._rng.normal(0, 1.5)]))
            left, right = (self._frame(scene) for scene in self._scenes)
            yield FrameSet(self.trigger, {"left": left, "right": right})

    def feed(self, recorder: Recorder, steps: int, shape: Callable[[FrameSet], FrameSet] = lambda pair: pair) -> None:
        """Have the recorder see so many steps, of pairs that `shape` may change first."""
        for _, pair in zip(range(steps), self.pairs(), strict=False):
            shaped = shape(pair)
            override = self._override()
            inputs = StepInputs(shaped, self._angular_rate_rad_s(), self._light_ahead(), override, self._steering())
            decision = self.loop.step(inputs)
            self._settings = [self._settings[-1], decision.setting]
            self.decisions[pair.trigger] = decision
            requests = (f"made up in step {self.trigger}",) if self.trigger % 10 == 0 and self.steered else ()
            recorder.take(ControlStep(inputs, decision, requests), self.loop, 2, {})

    def _angular_rate_rad_s(self) -> float | None:
        """Of an IMU that fails for 3 steps in 8."""
        return self._rng.random() * 3 if self.imu and self.trigger % 8 < 5 else None

    def _light_ahead(self) -> LightAhead | None:
        """Of a drive in light like this one's, that is not known for 3 steps in 8."""
        if not self.driven_before or self.trigger % 8 >= 5:
            return None
        levels, risen = 9.0 + np.cumsum(self._rng.normal(0.0, 0.7, (2, 90)), axis=1)
        return LightAhead(tuple(levels.tolist()), tuple(risen.tolist()), 70, 1.5)

    def _steering(self) -> Steering | None:
        """Of a consumer of the left picture that is silent for 3 steps in 8."""
        if not self.tracked or self.trigger % 8 >= 5:
            return None
        favours = np.round(self._rng.uniform(-1.0, 1.0, CELLS), 2)
        return Steering({"left": tuple(favours.tolist())}, ("slam",), 0.1)

    def _override(self) -> Override:
        """EV compensation from the third step on, locked now and then, with a shot every ten steps."""
        if not self.steered or self.trigger < 102:
            return NO_OVERRIDE
        held = START if self.trigger % 20 < 6 else None
        match self.trigger % 10:
            case 7:
                return Override(-1.3, held, ExposureSetting(300.0, 2.0))
            case 9:
                return Override(-1.3, self._settings[0], unseen=True)
        return Override(-1.3, held)

    def _frame(self, scene: NDArray[np.float64]) -> Frame:
        frame = expose(np.roll(scene, self.trigger, axis=1), self._settings[0], self._light, self.bits)
        frame.pixels[...] ^= self._rng.integers(0, 8, frame.pixels.shape, frame.pixels.dtype)  # noise: hard to compress
        time_ns = 10**12 + self.trigger * FRAME_NS
        return Frame(frame.pixels, self.bits, self.trigger, time_ns + 7, time_ns, time_ns + 9_000_000, frame.setting)


def record(path: Path, run: VirtualRun, steps: int = 60) -> Path:
    """A recording of a run, nothing dropped."""
    with ContinuousRecorder(path, steps, PublishConfig()) as recorder:
        run.feed(recorder, steps)
    assert recorder.failure is None
    return path


def replayed(path: Path, policy_id: str | None = None) -> list[Replayed]:
    return list(Replay(policy_id).steps(Recording(path)))


def copy(sources: Sequence[Path], target: Path, changed: Callable[[str, bytes], tuple[str, bytes]]) -> Path:
    """A file with the messages of others, one file after the other, each on the topic and of the bytes that `changed`
    makes of them."""
    with target.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "tests")
        channels: dict[str, int] = {}
        for source in sources:
            with source.open("rb") as content:
                for schema, channel, message in make_reader(content).iter_messages():
                    assert schema is not None
                    topic, data = changed(channel.topic, message.data)
                    if topic not in channels:
                        number = writer.register_schema(schema.name, schema.encoding, schema.data)
                        channels[topic] = writer.register_channel(topic, "cdr", number, channel.metadata)
                    times = message.log_time, message.publish_time
                    writer.add_message(channels[topic], times[0], data, times[1], message.sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return target


def as_in_fourteenth(topic: str, data: bytes) -> tuple[str, bytes]:
    """A message under the name that it had in recordings of the fourteenth format."""
    name = topic.removesuffix("_raw") if topic.endswith("/image_raw") else topic
    return f"/autoexpose{name}", data.replace(b"autoexpose-control/15", b"autoexpose-control/14")
