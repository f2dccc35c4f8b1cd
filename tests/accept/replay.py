"""Does virtual time tell the truth? A demo's run played again without transport and without clocks."""

from __future__ import annotations

from collections.abc import Sequence

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.demo.analysis import LightStep, StepRecord, light_steps
from autoexpose_daemon.demo.fakes import Pulse
from fake_camera.imaging import ImageSettings, ImageSource
from fake_camera.world.lighting import LightScript
from fake_camera.world.simulation import build_image_source
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.response import ResponseFunction

LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0, time_step_us=1.0)
START = ExposureSetting(2000.0, 0.0)
"""Of the demo: its bounds, the fakes' increment, and where it starts."""


def replay_demo(
    policy_id: str, *, triggers: Sequence[int], delay_frames: int, light: LightScript, seed: int, rate_hz: float = 60.0
) -> list[LightStep]:
    """The demo's light steps as the closed loop in virtual time settles on them.

    Parameters
    ----------
    policy_id
        Who decides.
    triggers
        Numbers of the wire's pulses at which pairs are taken, in order: they fix light and camera path.
    delay_frames
        A decision on the frame of one pulse applies from so many pulses later on, as measured in the demo.
    light, seed, rate_hz
        As the demo's.
    """
    sources = [build_image_source("room", camera, light, seed) for camera in ("left", "right")]
    loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START)
    settings = [START] * delay_frames
    pulses: list[Pulse] = []
    records: list[StepRecord] = []
    for index, trigger in enumerate(triggers):
        start_s = trigger / rate_hz
        time_ns = round(start_s * 1e9)
        left, right = (_frame(source, settings[index], start_s, index) for source in sources)
        decision = loop.step(FrameSet(trigger, {"left": left, "right": right}))
        settings.append(decision.setting)
        pulses.append(Pulse(trigger, time_ns, light.lux(start_s)))
        records.append(
            StepRecord(
                trigger,
                time_ns,
                settings[index],
                decision.level,
                decision.saturated_share,
                decision.black_share,
                decision.reason,
            )
        )
    return light_steps(pulses, records)


def _frame(source: ImageSource, setting: ExposureSetting, start_s: float, index: int) -> Frame:
    image = source.take(
        start_s,
        ImageSettings(setting.exposure_time_us, setting.gain_db, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1),
        noise_seed=index,
    )
    time_ns = round(start_s * 1e9)
    return Frame(image, 8, index, time_ns, time_ns, time_ns, setting)
