"""What `make test` leaves out: the longer checks in real time of `make accept`, and what `make test-kernel` does."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# Before anything imports numpy: on a busy machine the threads of BLAS wait for each other, and small matrices take
# several times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

LEFT_OUT = [Path(__file__).with_name(name) for name in ("accept", "kernel")]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests of these folders out unless they are asked for by name."""
    asked = [Path(argument.split("::")[0]).resolve() for argument in config.args]
    closed = [folder for folder in LEFT_OUT if not any(path.is_relative_to(folder) for path in asked)]
    kept = [item for item in items if not any(item.path.is_relative_to(folder) for folder in closed)]
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept
