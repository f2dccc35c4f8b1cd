"""The code blocks of the pages: configurations are valid, commands and their options exist, Python finds its names."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import yaml

from autoexpose_daemon import cli
from autoexpose_daemon.config.document import Config
from tests import REPOSITORY
from tools.stage_docs import stage
from tools.stage_package import ROOMS

CAMERAS = {"left": {"serial": "22500001"}, "right": {"serial": "22500002"}}
PLACEHOLDER = re.compile(r"\[.*?\]|\.\.\.|[A-Z]+=\S+ ")
COMMAND = re.compile(r"^\s*(?:sudo )?(?:\S*/)?autoexpose (?P<words>.*)$")


class Block(NamedTuple):
    """A code block, where it is, and what its fence says of its language."""

    at: str
    language: str
    text: str


def blocks() -> Iterator[Block]:
    pages = ["README.md", "CONTRIBUTING.md", "benchmarks/README.md"]
    pages += [str(path.relative_to(REPOSITORY)) for path in sorted((REPOSITORY / "docs").glob("*/*.md"))]
    for page in pages:
        text = (REPOSITORY / page).read_text()
        for found in re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
            yield Block(f"{page}:{text.count(chr(10), 0, found.start()) + 1}", found[1], found[2])


def each(language: str) -> list[Any]:
    return [pytest.param(block.text, id=block.at) for block in blocks() if block.language == language]


command_line = cache(cli.whole_command_line)


def test_links_lead_somewhere(tmp_path: Path) -> None:
    stage(tmp_path / "site")
    assert "](docs/" not in (tmp_path / "site/index.md").read_text()


@pytest.mark.parametrize("text", each("yaml"))
def test_a_configuration_is_valid(text: str) -> None:
    document = yaml.safe_load(text)
    if document.keys() <= Config.model_fields.keys():
        Config.model_validate({"cameras": CAMERAS, **document})


@pytest.mark.parametrize("text", each("python"))
def test_python_finds_its_names(text: str) -> None:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in ROOMS:
            module = importlib.import_module(node.module)
            assert not [name.name for name in node.names if not hasattr(module, name.name)]


def whole_lines(block: Block) -> list[str]:
    return block.text.replace("\\\n", " ").splitlines()


def calls() -> list[Any]:
    lines = [(block, line) for block in blocks() if block.language in ("", "sh") for line in whole_lines(block)]
    found = [(block, call["words"]) for block, line in lines if (call := COMMAND.match(line))]
    return [pytest.param(words, id=f"{block.at} {words[:40]}") for block, words in found]


@pytest.mark.parametrize("words", calls())
def test_a_command_has_these_options(words: str) -> None:
    command, rest = command_line(), shlex.split(PLACEHOLDER.sub("", words), comments=True)
    while rest and rest[0] in getattr(command, "commands", {}):
        command = command.commands[rest.pop(0)]
    assert not getattr(command, "commands", {}) or not rest or rest[0].startswith("-"), f"no command {rest[0]}"
    options = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    given = {word.split("=")[0] for word in rest if re.match(r"--?[a-z]", word)}
    assert not given - options - {"--help"}


def test_make_has_the_targets() -> None:
    targets = set(re.findall(r"^([\w-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE))
    named = {
        word
        for block in blocks()
        if not block.language
        for word in re.findall(r"^(?:sudo )?make ([\w-]+)", block.text, re.M)
    }
    assert named and not named - targets


def test_benchmarks_are_there() -> None:
    named = {path for block in blocks() for path in re.findall(r"benchmarks/\w+\.py", block.text)}
    assert named and all((REPOSITORY / path).exists() for path in named)
