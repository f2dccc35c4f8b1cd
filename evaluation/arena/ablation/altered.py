"""A policy with one constant altered, through some courses: a process of its own, started with `python -m`.

The module's source is altered before it is compiled, and before any module of control is imported. So everything that
follows from the constant is altered with it: copies by `from ... import`, arrays and defaults of arguments made of it.
That is why this file imports no more than the standard library and errors until then.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from types import CodeType, ModuleType
from typing import Any

from imaging.errors import AutoexposeError


@dataclass(frozen=True, slots=True)
class Alteration:
    """The text to take the place of the bytes from `start` to `end` of a module's source."""

    module: str
    start: int
    end: int
    text: str


@dataclass(frozen=True, slots=True)
class Request:
    """What to run: scenario, scene and seed of each course, its start (us, dB), and a bound on the frames of each."""

    alteration: Alteration | None
    policy: str
    courses: Sequence[tuple[str, str, int]]
    starts: Sequence[tuple[float, float]]
    frames: int | None = None


class AlteredModule(MetaPathFinder):
    """Finds one module, with its source altered; to be put before all other finders."""

    def __init__(self, alteration: Alteration) -> None:
        self._alteration = alteration

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification of the altered module; None for all others."""
        found = PathFinder.find_spec(fullname, path) if fullname == self._alteration.module else None
        if found is None or found.origin is None:
            return None
        return spec_from_file_location(fullname, found.origin, loader=_Altered(self._alteration, found.origin))


class _Altered(SourceFileLoader):
    def __init__(self, alteration: Alteration, path: str) -> None:
        super().__init__(alteration.module, path)
        self._alteration = alteration

    def get_code(self, fullname: str) -> CodeType:
        """Of the altered source, never of what is cached."""
        source, change = self.get_data(self.path), self._alteration
        return compile(source[: change.start] + change.text.encode() + source[change.end :], self.path, "exec")


def run_altered(request: Request) -> list[Any] | str:
    """The `Decisions` in each course, from a fresh process; a string: what the alteration breaks."""
    command = [sys.executable, "-m", __name__]
    done = subprocess.run(command, input=json.dumps(asdict(request)), capture_output=True, text=True, check=False)
    if done.returncode == 0:
        decisions: list[Any] | str = json.loads(done.stdout)
        return decisions
    raise AutoexposeError(f"a process ended with {done.returncode}: {done.stderr.strip()[-300:] or 'it was killed'}")


def _answer(request: dict[str, Any]) -> list[Any] | str:
    if request["alteration"]:
        sys.meta_path.insert(0, AlteredModule(Alteration(**request["alteration"])))
    try:
        from evaluation.arena.ablation.course import roll_out  # noqa: PLC0415

        return [
            roll_out(request["policy"], tuple(course), tuple(start), request["frames"])
            for course, start in zip(request["courses"], request["starts"], strict=True)
        ]
    except Exception as error:  # what an altered constant breaks is a result, too
        return f"{type(error).__name__}: {error}"


if __name__ == "__main__":
    json.dump(_answer(json.load(sys.stdin)), sys.stdout)
