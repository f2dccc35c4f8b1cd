"""How commands take a configuration file, and how they print: for people, or as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from documents.command_line import AsJson, CommandOutput, ConfigFile, ConfigOption, given_config, needed_config
from imaging.errors import ConfigurationError

app = typer.Typer()


@app.command()
def show(
    context: typer.Context, file: ConfigFile = None, *, config: ConfigOption = None, as_json: AsJson = False
) -> None:
    output = CommandOutput(context, as_json)
    output.show_facts({"path": "3 m", "exposure": "\x1b[2J"})
    output.show_table("cameras", ("serial", "us"), [("A", 5), ("LONG", 12345)], right=("us",))
    output.show_yaml({"config": str(needed_config(file, config))})
    output.say("for people")
    output.print("in passing")
    raise typer.Exit(1)


def test_people_get_lines_and_columns() -> None:
    result = CliRunner().invoke(app, ["rig.yaml"])
    assert result.exit_code == 1
    assert result.stdout.splitlines() == [
        "path      3 m",
        "exposure  \\x1b[2J",
        "serial     us",
        "A           5",
        "LONG    12345",
        "config: rig.yaml",
        "for people",
        "in passing",
    ]


@pytest.mark.parametrize("given", [["rig.yaml"], ["-c", "rig.yaml"]])
def test_programs_get_one_document_even_if_the_command_fails(given: list[str]) -> None:
    result = CliRunner().invoke(app, [*given, "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout) == {
        "path": "3 m",
        "exposure": "\x1b[2J",
        "cameras": [{"serial": "A", "us": 5}, {"serial": "LONG", "us": 12345}],
        "config": "rig.yaml",
    }
    assert result.stderr == "in passing\n"


def test_one_configuration_is_given_in_one_way() -> None:
    one, other = Path("a.yaml"), Path("b.yaml")
    assert given_config(None, None) is None
    assert given_config(one, None) == given_config(None, one) == needed_config(one, None) == one
    with pytest.raises(ConfigurationError, match=r"a\.yaml and -c b\.yaml"):
        given_config(one, other)
    with pytest.raises(ConfigurationError, match="autoexpose init"):
        needed_config(None, None)
