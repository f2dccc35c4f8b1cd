from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2

from tests import REPOSITORY

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
