"""The cost of one simulated view, rendering and sensor, by exposure time along the demo's path.

Run `.venv/bin/python benchmarks/bench_render.py`; prints medians of interleaved thread times in ms for 720x540 Mono8,
and the share of a core at 60 Hz on a machine where the literal step takes 3 ms. The goal, including sending, is 15 %.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from autoexpose_daemon.demo.reference_step import reference_step_ms
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.simulation import build_image_source

SETTINGS = ImageSettings(7500.0, 10.0, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
EXPOSURE_TIMES_US = (20.0, 2000.0, 7500.0, 40000.0)
VIEWS = 80
YARDSTICK_MS = 3.0


def main() -> None:
    started = time.perf_counter()
    source = build_image_source("room", "left", LightScript((Change(0.0, 150.0),)), seed=1)
    source.take(3.0, SETTINGS, 0)
    print(f"build {time.perf_counter() - started:.2f} s (with compilation when the cache is cold)")
    spent: dict[float, list[float]] = {time_us: [] for time_us in EXPOSURE_TIMES_US}
    for view in range(VIEWS):
        for time_us, times_ms in spent.items():
            settings = replace(SETTINGS, exposure_time_us=time_us)
            began_ns = time.thread_time_ns()
            source.take(2.0 + 0.3 * view, settings, view)
            times_ms.append((time.thread_time_ns() - began_ns) / 1e6)
    literal_ms = reference_step_ms(60)
    print(f"literal step here {literal_ms:.2f} ms")
    print("exposure us  median ms  worst ms  share of a core at 60 Hz where the literal step takes 3 ms")
    for time_us, times_ms in spent.items():
        median_ms = float(np.median(times_ms))
        share = median_ms * YARDSTICK_MS / literal_ms * 60e-3
        print(f"{time_us:11g}  {median_ms:9.2f}  {max(times_ms):8.2f}  {share:.0%}")


if __name__ == "__main__":
    main()
