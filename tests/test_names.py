"""One word for one thing: no public class of product or evaluation has the name of another."""

from __future__ import annotations

import ast
from collections import defaultdict

from tests import REPOSITORY
from tools.stage_package import ROOMS


def test_no_two_classes_have_one_name() -> None:
    homes: dict[str, list[str]] = defaultdict(list)
    for room in set(ROOMS) - {"fake_camera"}:  # which imports nothing of ours, and has its own words
        for path in sorted((REPOSITORY / room).rglob("*.py")):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    homes[node.name].append(str(path.relative_to(REPOSITORY)))
    assert len(homes) > 300
    assert {name: paths for name, paths in homes.items() if len(paths) > 1} == {}
