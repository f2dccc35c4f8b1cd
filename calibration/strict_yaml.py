"""YAML files whose every mistake is one sentence."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from drivers.errors import ConfigurationError


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML takes the last of two equal keys without a word; a limit given twice must not silently be lost."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = [key_node.value for key_node, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.YAMLError(f"the key {key!r} stands twice, the second time in line {_line(node, key)}")
        return super().construct_mapping(node, deep)


def _line(node: yaml.MappingNode, key: str) -> int:
    lines: list[int] = [key_node.start_mark.line for key_node, _ in node.value if key_node.value == key]
    return max(lines) + 1


def load_mapping(path: Path, hint: str) -> dict[Any, Any]:
    """The mapping that a YAML file holds.

    Raises
    ------
    ConfigurationError
        When the file cannot be read, is not YAML, has a key twice, or holds no keys (then `hint` says what to write).
    """
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), _UniqueKeyLoader)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}): check its name and access") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: not UTF-8, or an impossible date
        raise ConfigurationError(f"{path}: not a YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict):
        raise ConfigurationError(f"{path}: no keys in it: {hint}")
    return document
