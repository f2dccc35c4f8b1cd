"""The reference of the Python interface: what it lists is there, has a docstring, and is all that examples use."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType

import pytest

from autoexpose_daemon import client, own_policy
from fake_camera import bench
from tests import REPOSITORY
from tools.stage_package import ROOMS

LISTED = re.findall(r"^::: (\S+)$", (REPOSITORY / "docs/look-up/python.md").read_text(), re.MULTILINE)
ALIASES = {"fake_camera.bench.Side"}
"""Of types: they have no docstrings."""


@pytest.mark.parametrize("name", LISTED)
def test_it_can_be_imported_and_says_what_it_is(name: str) -> None:
    listed = resolve_name(name)
    said = inspect.getdoc(listed)
    assert said and not said.startswith(f"{listed.__name__}("), "a dataclass says nothing by itself"


def test_each_name_is_listed_once() -> None:
    assert len(LISTED) > 30
    assert len(set(LISTED)) == len(LISTED)


@pytest.mark.parametrize("face", [bench, client, own_policy], ids=lambda face: face.__name__)
def test_all_that_a_face_offers_is_listed(face: ModuleType) -> None:
    assert {f"{face.__name__}.{name}" for name in face.__all__} <= {*LISTED, *ALIASES}


def imports(path: Path) -> Iterator[tuple[str, str]]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in ROOMS:
            yield from ((node.module, name.name) for name in node.names)


@pytest.mark.parametrize("path", sorted((REPOSITORY / "examples").rglob("*.py")), ids=lambda path: path.stem)
def test_examples_use_what_is_listed(path: Path) -> None:
    for module, name in imports(path):
        assert f"{module}.{name}" in LISTED
        assert hasattr(importlib.import_module(module), name)
