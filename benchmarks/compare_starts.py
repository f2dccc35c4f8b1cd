"""Whether a policy finds the best exposure of a still scene from wherever it starts.

A local maximum may hold it: exposed for a window, the room around it is black, and for the room, the window is white.
Furnished rooms, some with the window in view, in five lights, seen by each eye and by both; three starts each. The
ratio is the information of the exposure that a policy ends at to that of the best one (`Oracle`, time before gain).

Run with `.venv/bin/python benchmarks/compare_starts.py [--policy ID]`: two minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import product

import cv2
import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from evaluation.scenes.scenarios import Course
from evaluation.scenes.views import Scene, build_views
from evaluation.stage.camera import LIMITS, time_first
from evaluation.stage.delayed_loop import Entrant
from evaluation.stage.oracle import LEVELS, Oracle
from evaluation.stage.rendering import Stage
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.simulation import RoomView, Side

LUX = (0.3, 1.0, 3.0, 10.0, 100.0)
EYES: tuple[tuple[Side, ...], ...] = (("left",), ("right",), ("left", "right"))
STARTS = {"2 ms": time_first(np.log2(2000.0)), "darkest": LIMITS.darkest, "brightest": LIMITS.brightest}
FRAMES = 60
POOR = 0.93


def rooms() -> Iterator[tuple[str, int, dict[Side, Scene]]]:
    """Name, seed and views: where the demo starts, somewhere in the room, and before the window."""
    for seed in range(3):
        renderer, path = Renderer(furnished_room(seed), Pinhole()), CameraPath()
        yield "demo", seed, {side: RoomView(renderer, path, side) for side in ("left", "right")}
    for at_window, seed in product((False, True), range(2)):
        yield "window" if at_window else "room", seed, build_views("room", seed, lambda _: 0.0, at_window)


def ratios(stage: Stage, eyes: tuple[Side, ...], policy: str) -> Iterator[tuple[str, float, float, float]]:
    """From each start: its name, the ratio, the level it ends at, and the best one (stops)."""
    oracle, levels = Oracle(stage, eyes, "information", exhaustive=True), LEVELS[::3]
    values = np.array([oracle.judge(time_first(float(level))) for level in levels])
    joint = np.mean(values / np.maximum(values.max(axis=0), 1e-9), axis=1)
    for name, start in STARTS.items():
        delayed = Entrant.of(policy).enter(start)
        for frame in range(FRAMES):
            stage.frame = frame  # the noise changes, nothing else does
            delayed.step(lambda setting: stage.take(setting, eyes))
        level = delayed.decisions[-1].setting.level
        yield name, float(np.interp(level, levels, joint)) / joint.max(), level, float(levels[joint.argmax()])


def main() -> None:
    """Print a line for each poor end, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", choices=POLICY_IDS, default=DEFAULT_POLICY)
    policy = parser.parse_args().policy
    cv2.setNumThreads(1)
    found: list[float] = []
    for (name, seed, views), lux in product(rooms(), LUX):
        stage = Stage(views, Course(LightScript((Change(0.0, lux),)), lambda _: 0.0, 0), seed)
        for eyes in EYES:
            for start, ratio, level, best in ratios(stage, eyes, policy):
                found.append(ratio)
                if ratio < POOR:
                    what = f"{name} {seed}, {lux:g} lux, {' and '.join(eyes)}, from {start}"
                    print(f"{what:55} {ratio:.2f} of the best: level {level:.1f}, best {best:.1f}", flush=True)
    worst = np.sort(found)[: len(found) // 20].mean()
    poor = sum(ratio < POOR for ratio in found)
    print(f"{policy}: mean {np.mean(found):.3f}, worst twentieth {worst:.3f}, {poor} of {len(found)} below {POOR}")


if __name__ == "__main__":
    main()
