"""What stands in for newer Pythons does what theirs does; `make test-platforms` runs it on Python 3.10."""

from __future__ import annotations

from concurrent.futures import Future

import pytest

from imaging.python310 import FutureTimeoutError


def test_a_future_that_is_late_raises_what_is_caught() -> None:
    with pytest.raises(FutureTimeoutError):
        Future[None]().result(0.0)
