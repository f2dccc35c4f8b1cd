"""What one simulated view costs: rendering and sensor, by the number of instants rendered per exposure.

Run `.venv/bin/python benchmarks/bench_render.py`; prints medians of thread time in ms for 720x540 Mono8, interleaved.
The goal is at most 4 ms with one or two instants: two cameras at 60 Hz share two cores with the daemon.
"""

from __future__ import annotations

import time

import numpy as np

from fake_camera.imaging import ImageSettings
from fake_camera.path import CameraPath
from fake_camera.render import Pinhole, Renderer
from fake_camera.room import furnished_room
from fake_camera.sensor import Sensor, SensorModel

SETTINGS = ImageSettings(7500.0, 10.0, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
VIEWS = 80


def main() -> None:
    started = time.perf_counter()
    renderer = Renderer(furnished_room(1), Pinhole())
    sensor = Sensor(SensorModel(), 1)
    path = CameraPath()
    sensor.expose(renderer.render(path.pose(0.0)[None], 150.0), SETTINGS, 0)
    print(f"build {time.perf_counter() - started:.2f} s (with compilation when the cache is cold)")
    spent: dict[int, list[tuple[int, int]]] = {1: [], 2: [], 4: []}
    for view in range(VIEWS):
        for instants, times in spent.items():
            poses = np.array([path.pose(view * 0.3 + i * 7.5e-3 / instants) for i in range(instants)])
            began = time.thread_time_ns()
            radiance = renderer.render(poses, 150.0)
            rendered = time.thread_time_ns()
            sensor.expose(radiance, SETTINGS, view)
            times.append((rendered - began, time.thread_time_ns() - rendered))
    print("instants  render  sensor  view  worst (ms)")
    for instants, times in spent.items():
        milliseconds = np.array(times) / 1e6
        render, exposed = np.median(milliseconds, axis=0)
        whole = milliseconds.sum(axis=1)
        print(f"{instants:8d}  {render:6.2f}  {exposed:6.2f}  {np.median(whole):4.2f}  {whole.max():5.2f}")


if __name__ == "__main__":
    main()
