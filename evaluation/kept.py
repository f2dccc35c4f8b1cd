"""Results on disk by key, so that hours of work can be interrupted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from documents.files import replace_file
from imaging.errors import AutoexposeError


class KeptResults:
    """One JSON file for each result, named by its key, a hash."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, key: str) -> tuple[Any] | None:
        """The result in a tuple, because it may be None; None when no result is kept."""
        try:
            return (json.loads(self._path(key).read_text(encoding="utf-8")),)
        except (FileNotFoundError, ValueError):
            return None

    def put(self, key: str, result: Any) -> None:
        """Keep a result, atomically; AutoexposeError when it cannot be written."""
        path = self._path(key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, json.dumps(result).encode())
        except OSError as error:
            raise AutoexposeError(
                f"{path}: the result cannot be saved ({error.strerror}): fix that and run the same command to resume"
            ) from None

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.json"
