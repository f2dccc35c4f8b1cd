"""Count the Python files and lines of each room, as git has them: `make count`."""

from __future__ import annotations

import subprocess
from pathlib import Path

PRODUCT = ("imaging", "documents", "drivers", "calibration", "autoexpose_daemon", "navigation")
OTHERS = ("evaluation", "fake_camera", "tests")


def count(room: str) -> tuple[int, int]:
    """Files and lines of a room."""
    listed = subprocess.run(["git", "ls-files", f"{room}/*.py"], check=True, capture_output=True, text=True).stdout
    files = [Path(name) for name in listed.splitlines() if Path(name).is_file()]
    return len(files), sum(len(file.read_bytes().splitlines()) for file in files)


if __name__ == "__main__":
    counts = {room: count(room) for room in (*PRODUCT, *OTHERS)}
    product = tuple(map(sum, zip(*(counts[room] for room in PRODUCT), strict=True)))
    rows = [*((room, *counts[room]) for room in PRODUCT), ("product", *product)]
    for name, files, lines in [("", "files", "lines"), *rows, *((room, *counts[room]) for room in OTHERS)]:
        print(f"{name:18}{files:>6}{lines:>8}")
