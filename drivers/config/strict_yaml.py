"""YAML files in which every mistake is reported, in one sentence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from drivers.config.files import read_regular
from drivers.errors import ConfigurationError

MOST_BYTES = 1 << 18
"""A response file has 8000; a file named by mistake is refused before minutes of parsing."""
MOST_ALIASES = 16
"""Two cameras may share a region; nested aliases can multiply a file's content beyond any memory."""


class _StrictLoader(yaml.SafeLoader):
    """PyYAML silently keeps the last of two equal keys; a limit that is given twice must not be lost."""

    _aliases = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            self._aliases += 1
            if self._aliases > MOST_ALIASES:
                raise yaml.YAMLError(f"it has more than {MOST_ALIASES} aliases (*name): write out what they stand for")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = Counter(key_node.value for key_node, _ in node.value if isinstance(key_node, yaml.ScalarNode))
        for key, times in keys.items():
            if times > 1:
                raise yaml.YAMLError(f"the key {key!r} appears twice, the second time in line {_line(node, key)}")
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> Any:
        if isinstance(node, yaml.ScalarNode):
            node.value.encode()  # escapes can make lone surrogates, which cannot be printed: UnicodeEncodeError
        return super().construct_scalar(node)


def _line(node: yaml.MappingNode, key: str) -> int:
    lines: list[int] = [key_node.start_mark.line for key_node, _ in node.value if key_node.value == key]
    return max(lines) + 1


def load_mapping(path: Path, hint: str) -> dict[Any, Any]:
    """The mapping that a YAML file holds.

    Raises
    ------
    ConfigurationError
        When the file cannot be read, is too long, is not a regular file or not YAML, has a key twice, or has no keys
        (then `hint` says what to write).
    """
    try:
        content = read_regular(path, MOST_BYTES)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}): check its name and access") from error
    except ValueError as error:  # a NUL in its name
        raise ConfigurationError(f"{str(path)!r}: is not a file name: {error}") from error
    try:
        document = yaml.load(content.decode("utf-8"), _StrictLoader)
    except Exception as error:  # PyYAML hardly checks values of dates or of tags such as !!int
        raise ConfigurationError(f"{path}: not a YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict):
        raise ConfigurationError(f"{path}: has no keys: {hint}")
    return document
