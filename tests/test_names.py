"""One word for one thing: no class has the name of another, and the glossary's words are in the code."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from tests import REPOSITORY
from tools.stage_package import ROOMS

OTHER_WORDS = {"anomaly", "complaint", "defect", "doubt", "remark", "shortcoming", "shortfall"}
"""Words that once meant what the glossary has a word for."""
GLOSSARY_ROW = re.compile(r"\| ([\w -]+) \| .+ \| `(\w+)` \|")


def modules() -> Iterator[tuple[Path, ast.Module]]:
    """The modules of product and evaluation; `fake_camera`, which imports nothing of ours, has its own words."""
    for path in chain.from_iterable(
        sorted((REPOSITORY / room).rglob("*.py")) for room in ROOMS if room != "fake_camera"
    ):
        yield path, ast.parse(path.read_text())


def test_no_two_classes_have_one_name() -> None:
    homes: dict[str, list[str]] = defaultdict(list)
    for path, module in modules():
        for node in module.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].append(str(path.relative_to(REPOSITORY)))
    assert len(homes) > 300
    assert {name: paths for name, paths in homes.items() if len(paths) > 1} == {}


def test_the_words_of_the_glossary_are_defined() -> None:
    rows = GLOSSARY_ROW.findall((REPOSITORY / "docs/look-up/glossary.md").read_text())
    assert len(rows) >= 30
    assert len({word for word, _ in rows}) == len(rows)
    defined = "\n".join(ast.unparse(module) for _, module in modules())
    for word, name in rows:
        assert re.search(rf"^(class )?{name}\b", defined, re.MULTILINE), f"{word}: nothing is named {name}"


def test_what_has_a_word_has_no_other() -> None:
    for path, module in modules():
        for node in ast.walk(module):
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                words = re.findall("[a-z]+", re.sub(r"([A-Z])", r"_\1", node.name).lower())
                used = OTHER_WORDS & {form for word in words for form in (word, word.removesuffix("s"))}
                assert not used, f"{path.relative_to(REPOSITORY)}: {node.name}: see docs/look-up/glossary.md"
