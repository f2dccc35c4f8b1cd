"""For all tests of the page."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _all_are_brisk(brisk: None) -> None:
    """See there."""
