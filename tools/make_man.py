"""Write the manual pages of `autoexpose` and its commands, made from the command line itself: make_man.py FOLDER.

Run by the Python of an installation, whose commands are described.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from autoexpose_daemon.cli import whole_command_line

_COMMANDS_OF_TYPER = ("--install-completion", "--show-completion")


def pages(name: str, command: Any) -> Iterator[tuple[str, str]]:
    """File names and texts, of a command and those below it."""
    below: dict[str, Any] = getattr(command, "commands", {})
    yield f"{name.replace(' ', '-')}.1", _page(name, command, below)
    for word, sub in sorted(below.items()):
        yield from pages(f"{name} {word}", sub)


def _page(name: str, command: Any, below: dict[str, Any]) -> str:
    title, help_text = name.replace(" ", "-"), _plain(command.help)
    arguments = [parameter for parameter in command.params if not parameter.opts[0].startswith("-")]
    options = [parameter for parameter in command.params if parameter not in arguments]
    usage = [f"\\fB{name}\\fR [\\fIoptions\\fR]"]
    usage += ["\\fIcommand\\fR ..."] if below else []
    usage += [f"\\fI{_name(argument)}\\fR" for argument in arguments]
    lines = [
        f'.TH {title.upper()} 1 "" "autoexpose {version("autoexpose-daemon")}"',
        ".SH NAME",
        f"{title} \\- {_escaped(help_text.split('. ')[0].split(chr(10))[0].rstrip('.'))}",
        ".SH SYNOPSIS",
        " ".join(usage),
        ".SH DESCRIPTION",
        *(_escaped(line) or ".PP" for line in help_text.splitlines()),
    ]
    if arguments:
        lines += [".SH ARGUMENTS", *_listed((f"\\fI{_name(it)}\\fR", _plain(it.help)) for it in arguments)]
    shown = [option for option in options if option.opts[0] not in _COMMANDS_OF_TYPER]
    lines += [".SH OPTIONS", *_listed((_option(it), _plain(it.help)) for it in shown)]
    lines += _listed([("\\fB\\-\\-help\\fR", "Show the help and exit.")])
    if below:
        named = ((f"\\fB{title}\\-{_escaped(word)}\\fR(1)", _plain(sub.help)) for word, sub in sorted(below.items()))
        lines += [".SH COMMANDS", *_listed(named)]
    if " " in name:
        lines += [".SH SEE ALSO", f"\\fB{name.rpartition(' ')[0].replace(' ', '-')}\\fR(1)"]
    return "\n".join(lines) + "\n"


def _listed(items: Any) -> list[str]:
    return [line for term, text in items for line in (".TP", term, _escaped(" ".join(text.split())))]


def _option(parameter: Any) -> str:
    names = ", ".join(f"\\fB{_escaped(name)}\\fR" for name in (*parameter.opts, *parameter.secondary_opts))
    return names if getattr(parameter, "is_flag", False) else f"{names} \\fI{_name(parameter)}\\fR"


def _name(parameter: Any) -> str:
    return _escaped(parameter.metavar or parameter.name.upper())


def _plain(text: str | None) -> str:
    return (text or "").strip()


def _escaped(text: str) -> str:
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{text}" if text.startswith((".", "'")) else text


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in pages("autoexpose", whole_command_line()):
        (folder / file).write_text(text, encoding="utf-8")
