"""A pytest plugin that notes which functions each test runs, and how long that takes.

``pytest -p tests.mutation.tracing`` loads it, and `MUTATION_TRACE` names the file that it writes: JSON, by test.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import coverage
import pytest

from tests.mutation.relevance import function_lines
from tests.mutation.scope import FOLDERS


class Tracer:
    """Watches the session."""

    def __init__(self, out: Path) -> None:
        self._out = out
        ours = [f"{folder}/*" for folder in FOLDERS.values()]
        self._coverage = coverage.Coverage(data_file=None, include=ours, config_file=False)
        self._seconds: dict[str, float] = defaultdict(float)
        self._fixtures: dict[str, list[str]] = {}
        self._failed: set[str] = set()

    def pytest_sessionstart(self) -> None:
        self._coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self._fixtures[item.nodeid] = [_fixture(item.path, name) for name in getattr(item, "fixturenames", ())]
        self._coverage.switch_context(item.nodeid)
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Generator[None, object, object]:
        """What is made once for several tests counts for each of them."""
        if fixturedef.scope != "module":
            return (yield)
        self._coverage.switch_context(_fixture(request.path, fixturedef.argname))
        try:
            return (yield)
        finally:
            # The test that asked for it is the one last begun.
            self._coverage.switch_context(next(reversed(self._fixtures)))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._seconds[report.nodeid] += report.duration
        if not report.passed:
            self._failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        self._coverage.stop()
        functions = self._functions_by_context()
        tests = {
            test: {
                "seconds": round(self._seconds[test], 3),
                "functions": sorted(set().union(*(functions.get(context, ()) for context in (test, *fixtures)))),
            }
            for test, fixtures in self._fixtures.items()
            if test not in self._failed
        }
        self._out.write_text(json.dumps(tests))

    def _functions_by_context(self) -> dict[str, set[str]]:
        data, found = self._coverage.get_data(), defaultdict(set)
        here = Path.cwd()
        for file in map(Path, data.measured_files()):
            if file.suffix != ".py":
                continue
            path, names = file.relative_to(here).as_posix(), function_lines(file.read_text())
            for line, contexts in data.contexts_by_lineno(str(file)).items():
                for context in contexts:
                    if line in names:
                        found[context].add(f"{path}:{names[line]}")
        return found


def _fixture(path: Path, name: str) -> str:
    return f"fixture {name} of {path}"


def pytest_configure(config: pytest.Config) -> None:
    """Begin, where asked for."""
    if out := os.environ.get("MUTATION_TRACE"):
        config.pluginmanager.register(Tracer(Path(out)))
