"""Compiled functions where nothing can be written."""

from __future__ import annotations

import pytest
from numba.core import caching

from fake_camera.world.compiled import compiled


def test_functions_compile_where_nothing_can_be_cached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])

    @compiled(fastmath=True)
    def twice(number: int) -> int:
        return 2 * number

    assert twice(21) == 42
