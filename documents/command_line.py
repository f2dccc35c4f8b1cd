"""What the commands of the terminal have in common: how they take a configuration file, and how they print."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console

from documents.text import readable
from imaging.errors import ConfigurationError

ConfigFile = Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="The configuration, a YAML file.")]
ConfigOption = Annotated[Path | None, typer.Option("-c", "--config", help="The same, as an option.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print it as JSON.")]


def given_config(file: Path | None, option: Path | None) -> Path | None:
    """The configuration file that a command is given, as an argument or as an option.

    Raises ConfigurationError if both are given.
    """
    if file is not None and option is not None:
        raise ConfigurationError(f"{file} and -c {option}: give one configuration file")
    return option if file is None else file


def needed_config(file: Path | None, option: Path | None) -> Path:
    """The same of a command that needs one; raises ConfigurationError also without."""
    config = given_config(file, option)
    if config is None:
        raise ConfigurationError("no configuration file is given: name one; autoexpose init writes a first one")
    return config


def yaml_text(document: Mapping[str, Any]) -> str:
    """A document in YAML, in the order of its keys, and with no line broken."""
    return yaml.safe_dump(dict(document), sort_keys=False, allow_unicode=True, width=1000)


class CommandOutput(Console):
    """What a command prints: for people line by line, or for programs as one JSON document, when the command ends.

    With JSON, what is printed in passing (progress, remarks) goes to standard error.
    """

    def __init__(self, context: typer.Context, as_json: bool) -> None:
        super().__init__(highlight=False, markup=False, stderr=as_json)
        self.as_json = as_json
        self.document: dict[str, Any] = {}
        context.call_on_close(self._finish)

    def show_facts(self, facts: Mapping[str, str]) -> None:
        """Print names and what they are, aligned."""
        self.document |= facts
        if not self.as_json:
            width = max(map(len, facts), default=0)
            for name, value in facts.items():
                typer.echo(readable(f"{name:{width}}  {value}"))

    def show_table(
        self, name: str, columns: Sequence[str], rows: Sequence[Sequence[object]], right: Sequence[str] = ()
    ) -> None:
        """Print rows below the names of their columns; `right` names those that hold numbers."""
        self.document[name] = [dict(zip(columns, row, strict=True)) for row in rows]
        if self.as_json or not rows:
            return
        cells = [list(columns), *([readable(str(value)) for value in row] for row in rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for line in cells:
            padded = (
                f"{cell:>{width}}" if name in right else f"{cell:{width}}"
                for name, cell, width in zip(columns, line, widths, strict=True)
            )
            typer.echo("  ".join(padded).rstrip())

    def show_yaml(self, document: Mapping[str, Any]) -> None:
        """Print a document in YAML."""
        self.document |= document
        if not self.as_json:
            typer.echo(yaml_text(document), nl=False)

    def say(self, sentence: str) -> None:
        """Print a line for people; what it says is in the document already, or in a file."""
        if not self.as_json:
            typer.echo(readable(sentence))

    def _finish(self) -> None:
        if self.as_json:
            typer.echo(json.dumps(self.document, indent=1))
