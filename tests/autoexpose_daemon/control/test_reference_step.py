"""The yardstick of steps, and the benchmark."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.demo.reference_step import ReferenceStep, reference_step_ms, synthetic_frames
from tests import REPOSITORY


def test_the_yardstick_takes_time_and_leaves_the_threads_alone() -> None:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        assert reference_step_ms(3) > 0.1
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(threads)


def test_frames_are_seeded_and_moving() -> None:
    one, again = synthetic_frames(3), synthetic_frames(3)
    assert all(np.array_equal(a, b) for a, b in zip(one, again, strict=True))
    assert not np.array_equal(*one)
    assert not np.array_equal(one[0], synthetic_frames(4)[0])


def test_it_computes_the_metric_that_the_tuned_step_computes() -> None:
    previous, current = synthetic_frames()
    step = ReferenceStep()
    image = ImagePreparation().prepare(current)
    literal = step._metric(image) * 1e5 / (255 * image.size)
    assert literal == pytest.approx(GradientMetric().measure(image), rel=1e-12)
    delta_level, flow_px = step(previous, current)
    assert abs(delta_level) < 10
    assert 0.1 < flow_px < 5


BENCHMARK = REPOSITORY / "benchmarks" / "bench_step.py"


def test_the_benchmark_writes_its_figures(tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    subprocess.run([sys.executable, str(BENCHMARK), "--repeats", "3", "--json", str(out)], check=True, timeout=60)
    figures = json.loads(out.read_text())
    assert figures["opencv_version"] == cv2.__version__
    assert figures["ratio_floor_native"] > figures["ratio_default_native"] > 0
    assert figures["ratio_native"] > 1
    assert figures["ratio_native_same_flow"] > 0
    assert set(figures["predictions_us"]) == {"7", "13", "25", "49"}
