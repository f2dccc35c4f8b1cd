"""Every command line of README and docs, and what becomes of each: command_lines.yaml."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from tests import REPOSITORY

TABLE = Path(__file__).with_suffix(".yaml")
_FENCE = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
_PROMPT = "$ "


def command_lines() -> dict[str, str]:
    """The command lines, and where each stands first.

    They are what stands after a prompt in a block of code without a language, or in one of `sh`; without a prompt, all
    lines. Comments, and the folder of this repository's environment, are left out.
    """
    found: dict[str, str] = {}
    for page in [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]:
        text = page.read_text()
        for block in _FENCE.finditer(text):
            if block[1] in ("", "sh"):
                at = f"{page.relative_to(REPOSITORY)}:{text.count(chr(10), 0, block.start()) + 1}"
                for line in _commands(block[2]):
                    found.setdefault(line, at)
    return found


def _commands(block: str) -> Iterator[str]:
    lines = block.replace("\\\n", " ").splitlines()
    if any(line.startswith(_PROMPT) for line in lines):
        lines = [line.removeprefix(_PROMPT) for line in lines if line.startswith(_PROMPT)]
    whole = ""
    for line in lines:
        whole = f"{whole}\n{line}" if whole else line
        try:
            shlex.split(whole, comments=True)
        except ValueError:  # a quotation goes on
            continue
        yield _bare(whole)
        whole = ""


def _bare(line: str) -> str:
    without_comment = re.sub(r"\s+#\s.*$", "", line)
    return re.sub(r"\s+", " ", without_comment.replace(".venv/bin/", "")).strip()


def table() -> dict[str, Any]:
    """The data file."""
    document = yaml.safe_load(TABLE.read_text())
    assert isinstance(document, dict)
    return document


def in_order(steps: list[Any]) -> Iterator[str]:
    """The command lines of a session."""
    for step in steps:
        if isinstance(step, str):
            yield step
        else:
            yield step["run"]
            yield from in_order(step.get("meanwhile", []))


def readmes_rig() -> str:
    """The configuration that README shows."""
    found = re.search(r"^```yaml\n(# rig.yaml\n.*?)^```$", (REPOSITORY / "README.md").read_text(), re.M | re.S)
    assert found
    return found[1]
