"""`make accept`: the longer checks in real time. They are left out of `make test`."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave these tests out unless they are asked for by name."""
    if any(HERE in (path := Path(argument).resolve()).parents or path == HERE for argument in config.args):
        return
    kept = [item for item in items if HERE not in item.path.parents]
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept
