"""Count the Python files and lines of each room, as git has them: `make count`."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tools.stage_package import ROOMS

OTHERS = ("evaluation", "fake_camera", "tests")
PRODUCT = tuple(room for room in ROOMS if room not in OTHERS)


def count(room: str) -> tuple[int, int]:
    """Files and lines of a room."""
    listed = subprocess.run(["git", "ls-files", f"{room}/*.py"], check=True, capture_output=True, text=True).stdout
    files = [Path(name) for name in listed.splitlines() if Path(name).is_file()]
    return len(files), sum(len(file.read_bytes().splitlines()) for file in files)


if __name__ == "__main__":
    counts = {room: count(room) for room in (*PRODUCT, *OTHERS)}
    counts["product"] = sum(counts[room][0] for room in PRODUCT), sum(counts[room][1] for room in PRODUCT)
    for name in (*PRODUCT, "product", *OTHERS):
        files, lines = counts[name]
        print(f"{name:18}{files:5} files{lines:7} lines")
