"""The cost of recording: processor time and bytes per stereo pair, by compression and by noise in the images.

Run `.venv/bin/python benchmarks/bench_record.py`; 720x540 Mono8, medians of process time per pair. Writing to disk
counts only as far as the kernel does it immediately. Bright images have little noise, dim ones at high gain have much.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.recording import file
from autoexpose_daemon.recording.file import Step
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import LightScript
from fake_camera.world.simulation import build_image_source
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.response import ResponseFunction

LIGHTS = {"bright, 250 us, 0 dB": ExposureSetting(250.0, 0.0), "dim, 60 us, 24 dB": ExposureSetting(60.0, 24.0)}
PAIRS, ROUNDS, RATE_HZ = 20, 6, 60.0


def main() -> None:
    loop = ControlLoop(
        "neves2009", ResponseFunction.linear(), ExposureLimits(20.0, 7500.0, 0.0, 30.0), ExposureSetting(250.0, 0.0)
    )
    print("images                compression  MB/pair  MB/s at 60 Hz  ms/pair  % of a core")
    for name, setting in LIGHTS.items():
        pairs = views(setting)
        for compression in CompressionType:
            file.COMPRESSION = compression
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "bench.mcap"
                spent_ms = record(path, pairs, loop)
                megabytes = path.stat().st_size / (PAIRS * ROUNDS) / 1e6
            cost = f"{megabytes:7.3f}  {megabytes * RATE_HZ:13.1f}  {spent_ms:7.2f}  {spent_ms * RATE_HZ / 10:11.1f}"
            print(f"{name:20}  {compression.name:11}  {cost}")


def views(setting: ExposureSetting) -> list[FrameSet]:
    sources = [build_image_source("room", camera, LightScript.default(), 0) for camera in ("left", "right")]
    taken = ImageSettings(setting.exposure_time_us, setting.gain_db, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
    pairs = []
    for index in range(PAIRS):
        left, right = (
            Frame(source.take(index / 10, taken, noise_seed=index), 8, index, index, index, index, setting)
            for source in sources
        )
        pairs.append(FrameSet(index, {"left": left, "right": right}))
    return pairs


def record(path: Path, pairs: list[FrameSet], loop: ControlLoop) -> float:
    """Median time per pair over rounds of all pairs, ms."""
    decision = loop.step(pairs[0])
    recording = file.RecordingFile(path, "rig")
    spent_ms = []
    for index in range(ROUNDS):
        began_s = time.process_time()
        for number, pair in enumerate(pairs):
            step = Step(index * PAIRS + number, 2, StepInputs(pair), decision)
            recording.write(step, loop.setup, loop.state() if number == 0 else None)
        spent_ms.append((time.process_time() - began_s) / len(pairs) * 1e3)
    recording.close(PAIRS * ROUNDS, 0)
    return float(np.median(spent_ms))


if __name__ == "__main__":
    main()
