"""For all tests of the daemon."""

from __future__ import annotations

import pytest

from tests.autoexpose_daemon.service.service_process import Within


@pytest.fixture
def within(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Within:
    return Within(monkeypatch, capsys)


@pytest.fixture(autouse=True)
def _brisk_where_something_is_published(request: pytest.FixtureRequest) -> None:
    if request.path.parent.name in ("client", "page", "publish"):
        request.getfixturevalue("brisk")
