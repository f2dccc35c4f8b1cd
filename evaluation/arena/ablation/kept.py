"""What is finished, on disk, so that hours of work can be interrupted."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from drivers.config.files import replace_file
from drivers.errors import AutoexposeError
from evaluation.arena.count import ROOT

_CODE = ("autoexpose_daemon/control", "calibration", "drivers", "evaluation", "fake_camera/world")


class Kept:
    """Results by what was asked, as JSON; after any change of code they are not found again."""

    def __init__(self, folder: Path) -> None:
        state = hashlib.sha256()
        for path in sorted(path for room in _CODE for path in (ROOT / room).rglob("*")):
            if path.suffix in (".py", ".so", ".npz"):
                state.update(str(path).encode() + path.read_bytes())
        self._folder = folder / state.hexdigest()[:16]

    def get(self, asked: Any) -> tuple[Any] | None:
        """The result in a tuple; None: none is kept."""
        try:
            return (json.loads(self._path(asked).read_text(encoding="utf-8")),)
        except (FileNotFoundError, ValueError):
            return None

    def put(self, asked: Any, result: Any) -> None:
        """Keep a result; AutoexposeError when it cannot be written."""
        path = self._path(asked)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, json.dumps(result).encode())
        except OSError as error:
            raise AutoexposeError(f"{path}: cannot be written ({error.strerror}): make room and run it again") from None

    def _path(self, asked: Any) -> Path:
        return self._folder / f"{hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()}.json"
