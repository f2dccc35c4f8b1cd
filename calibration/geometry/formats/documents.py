"""The keys and values of a calibration file, be it YAML, JSON, XML of OpenCV, or the INI of ROS's first calibrator."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

from documents.strict_yaml import parse_mapping
from documents.text import shortened
from imaging.errors import ConfigurationError

_SECTION = re.compile(r"\[([^\[\]]*[A-Za-z][^\[\]]*)\]")
_WORDS = re.compile(r"[A-Za-z][A-Za-z _]*")
_DEEPEST = 16
INI: Final = "cameras of an INI file"
"""The only key of what an INI file holds: its cameras by name."""


def parsed(text: str, path: Path, hint: str) -> dict[Any, Any]:
    """The content of a file; raises ConfigurationError, as `parse_mapping` does."""
    begin = text.lstrip()
    if begin.startswith("<"):
        return _xml(text, path, hint)
    if re.search(r"^\[image\]\s*$", text, re.MULTILINE):
        return _ini(text)
    return parse_mapping(text, path, hint)


def _xml(text: str, path: Path, hint: str) -> dict[Any, Any]:
    """What `cv2.FileStorage` writes; numbers stay text."""
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):  # entities can multiply a file beyond any memory
        raise ConfigurationError(f"{path}: is XML with declarations: {hint}")
    try:
        root = ET.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))  # which may name the encoding it had as bytes
        content = _value(root)
    except (ET.ParseError, ValueError) as error:
        raise ConfigurationError(f"{path}: not an XML file: {shortened(str(error), 200)}") from error
    if not isinstance(content, dict):
        raise ConfigurationError(f"{path}: has no keys: {hint}")
    return content


def _value(element: ET.Element, depth: int = 0) -> Any:
    if depth > _DEEPEST:
        raise ValueError(f"it is nested deeper than {_DEEPEST} levels")
    if len(element) == 0:
        return (element.text or "").strip().strip('"')
    if all(child.tag == "_" for child in element):
        return [_value(child, depth + 1) for child in element]
    content: dict[Any, Any] = {}
    for child in element:
        if child.tag in content:
            raise ValueError(f"the key {shortened(child.tag)} appears twice")
        content[child.tag] = _value(child, depth + 1)
    return content


def _ini(text: str) -> dict[Any, Any]:
    """Sections of keys, each on a line of its own above its numbers; those of `[image]` belong to all cameras."""
    sections: dict[str, dict[str, str]] = {}
    section, key = sections.setdefault("", {}), ""
    for line in (line.partition("#")[0].strip() for line in text.splitlines()):
        if match := _SECTION.fullmatch(line):
            section, key = sections.setdefault(match[1].strip(), {}), ""
        elif _WORDS.fullmatch(line):
            key = line.lower()
        elif line and key:
            section[key] = f"{section.get(key, '')} {line}".strip()
    image = sections.pop("image", {})
    cameras = {name: {**image, **keys, "camera_name": name} for name, keys in sections.items() if "distortion" in keys}
    return {INI: cameras}
