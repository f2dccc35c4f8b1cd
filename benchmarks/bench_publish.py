"""The cost of making and reading a pair's messages, relative to copying its pixels once."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.frames import MessageWriter, read_exposure_info, read_image, realtime_offset_ns
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet

TURNS = 300
SETTING = ExposureSetting(1000.0, 0.0)
DECISION = Decision(SETTING, 9.97, "held", 0.1, 0.0, 0.0, 1.0)


def median_us(work: Callable[[], object]) -> float:
    times_ns = []
    for _ in range(TURNS):
        before_ns = time.thread_time_ns()
        work()
        times_ns.append(time.thread_time_ns() - before_ns)
    return float(np.median(times_ns)) / 1000


def main() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (540, 720)).astype(np.uint8)
    frame = Frame(pixels, 8, 1, 1, 1, 1, SETTING)
    pair = FrameSet(1, {"left": frame, "right": frame})
    decisions = dict.fromkeys(pair.frames, DECISION)
    writer = MessageWriter("rig", 2)

    def write() -> dict[str, bytes]:
        return {message.topic: bytes(message.data) for message in writer.messages(pair, decisions, 1, 0)}

    data = write()
    costs = {
        "copying the pixels of both frames": median_us(lambda: (pixels.copy(), pixels.copy())),
        "making the pair's six messages": median_us(lambda: list(writer.messages(pair, decisions, 1, 0))),
        "reading both clocks": median_us(realtime_offset_ns),
        "reading two images": median_us(lambda: (read_image(data["image"]), read_image(data["image"]))),
        "reading two exposures": median_us(
            lambda: (read_exposure_info(data["exposure"]), read_exposure_info(data["exposure"]))
        ),
    }
    copy_us = costs["copying the pixels of both frames"]
    for name, cost_us in costs.items():
        print(f"{name:36} {cost_us:8.1f} us  {cost_us / copy_us:6.2f}")


if __name__ == "__main__":
    main()
