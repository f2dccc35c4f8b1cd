"""Test data from outside the repository: for tests with the marker `data`, which `make test-data` runs."""

from __future__ import annotations

import os
from pathlib import Path

DATA = Path(os.environ.get("AUTOEXPOSE_DATA", Path(__file__).parents[2] / "shared" / "data"))


def data(name: str) -> Path:
    """The path of a file or folder."""
    path = DATA / name
    assert path.exists(), f"{path} is missing: set AUTOEXPOSE_DATA to the folder that holds {name}"
    return path
