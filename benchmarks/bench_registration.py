"""The cost of finding FAST + ORB features in a 720x540 frame and registering them, compared with the literal step.

A look of `repeat` is that and the expansion of the view against the map.

Prints medians of interleaved thread times, on one thread; the threshold has settled before.

Run with `.venv/bin/python benchmarks/bench_registration.py [--repeats N] [--json OUT.json]`.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from autoexpose_daemon.demo.reference_step import ReferenceStep
from navigation.views.features import AdaptiveFinder, FastOrb
from navigation.views.registration import RULES, expansion, register

SHIFT_PX = 23
WARM_UP = 6


def two_views() -> tuple[np.ndarray, np.ndarray]:
    """A made-up scene and the same shifted, each with its own noise."""
    rng = np.random.default_rng(0)
    blots = sum(cv2.GaussianBlur(rng.normal(size=(540, 760)), (0, 0), sigma) * sigma for sigma in (1.0, 2.0, 5.0))
    scene = 128.0 + 30.0 * blots / np.std(blots)
    taught, seen = (
        np.clip(scene[:, start : start + 720] + rng.normal(0.0, 2.0, (540, 720)), 0, 255).astype(np.uint8)
        for start in (SHIFT_PX, 0)
    )
    return taught, seen


def stages() -> dict[str, Callable[[], object]]:
    """What is timed, by name."""
    taught, seen = two_views()
    literal, finder = ReferenceStep(), AdaptiveFinder(FastOrb())
    of_map, of_view = ([finder.find(image) for _ in range(WARM_UP)][-1] for image in (taught, seen))
    found = register(of_map, of_view).vote
    if found.shift_px is None or abs(found.shift_px - SHIFT_PX) > 1.0:
        raise SystemExit(
            f"the views are {SHIFT_PX} px apart, but {found.shift_px} was found: a time would mean nothing"
        )

    def look() -> float | None:
        view = finder.find(seen)
        return expansion(of_map, view, register(of_map, view), seen.shape[0] / 2)

    return {
        "literal step": lambda: literal(taught, seen),
        "a look of repeat": look,
        "features": lambda: finder.find(seen),
        **{f"registration, {name}": lambda rule=rule: register(of_map, of_view, rule) for name, rule in RULES.items()},
    }


def measure(timed: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Median thread time of each, microseconds; they are interleaved."""
    times_ns: dict[str, list[int]] = {name: [] for name in timed}
    for _ in range(repeats + WARM_UP):
        for name, stage in timed.items():
            start_ns = time.thread_time_ns()
            stage()
            times_ns[name].append(time.thread_time_ns() - start_ns)
    return {name: statistics.median(samples[WARM_UP:]) / 1e3 for name, samples in times_ns.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the numbers to this file")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    times_us = measure(stages(), max(1, arguments.repeats))
    literal_us = times_us["literal step"]
    print(f"OpenCV {cv2.__version__}, one thread, 720x540\n{'':28}{'us':>8}{'this / literal step':>22}")
    for name, time_us in times_us.items():
        print(f"{name:28}{time_us:8.0f}{time_us / literal_us:22.2f}")
    if arguments.json:
        figures = {
            "literal_steps": {name: round(time_us / literal_us, 3) for name, time_us in times_us.items()},
            "literal_us": round(literal_us, 1),
            "opencv_version": cv2.__version__,
        }
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
