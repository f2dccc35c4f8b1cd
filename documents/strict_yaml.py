"""YAML files in which every mistake is reported, in one sentence."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from documents.files import read_text
from documents.text import quoted, readable, shortened
from imaging.errors import ConfigurationError

MOST_BYTES = 1 << 20
"""A response file has 8000, one of OpenCV's with the corners of all views some 100,000; a file named by mistake is
refused before minutes of parsing."""
MOST_ALIASES = 16
"""Two cameras may share a region; nested aliases can multiply a file's content beyond any memory."""
DEEPEST = 64
"""The parsers recurse: libyaml's until the stack is full, and the process dead."""

_LONGEST_REASON = 200
_QUOTED_BEFORE, _QUOTED_AFTER = 30, 28
"""How much of a line that is wrong is quoted, before and after the place."""
_TAB = quoted("\t")
_LINES = re.compile("\\r\\n|[\\n\\r\x85\u2028\u2029]")
_TOO_DEEP = f"it is nested deeper than {DEEPEST} levels: write it flatter"
_PLAIN = {
    "exceeded maximum nesting depth": _TOO_DEEP,  # newer versions of libyaml look ahead
    "found character that cannot start any token": "no value begins with {here}: put it in quotes",
    "mapping values are not allowed in this context": "this : is one too many: align keys, or put text in quotes",
    "found unexpected end of stream": "the quotation is not closed",
    "unexpected end of stream": "the quotation is not closed",
    "could not find expected ':'": "a key without its `: `",
    "did not find expected ',' or '}'": "the {{ is not closed, or a comma is missing before {here}",
    "did not find expected ',' or ']'": "the [ is not closed, or a comma is missing before {here}",
    "did not find expected key": "this line is neither a key below the ones above it nor part of what comes before",
    "did not find expected node content": "a value is missing before {here}",
    "found undefined alias": "no value is named so with &: put text that begins with * in quotes",
    "found unknown escape character": "this is no escape: write \\\\, or use single quotes",
}
"""What PyYAML and libyaml say, and what helps."""
_VERSION = re.compile(r"\A\s*%YAML\b")
"""A directive that nothing depends on, and that OpenCV writes in a way of its own: `%YAML:1.0`."""
_OF_OPENCV = re.compile(r"\A\s*%YAML:")
_WITHOUT_BLANK = re.compile(r"^([ \t]*[A-Za-z_][\w.]*):(?=[^\s/:])", re.MULTILINE)
"""A key that only OpenCV reads, since in its dialect no blank need follow."""

if TYPE_CHECKING:
    _Loader = yaml.SafeLoader
else:
    _Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _StrictLoader(_Loader):
    """PyYAML silently keeps the last of two equal keys; a limit that is given twice must not be lost."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = Counter(key_node.value for key_node, _ in node.value if isinstance(key_node, yaml.ScalarNode))
        for key, times in keys.items():
            if times > 1:
                line = max(key_node.start_mark.line for key_node, _ in node.value if key_node.value == key) + 1
                raise yaml.YAMLError(f"the key {quoted(key)} appears twice, the second time in line {line}")
        return super().construct_mapping(node, deep)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except yaml.YAMLError:
            raise
        except Exception as error:  # PyYAML hardly checks values of dates or of tags such as !!int
            raise yaml.MarkedYAMLError(problem=str(error), problem_mark=node.start_mark) from error

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> Any:
        if isinstance(node, yaml.ScalarNode):
            node.value.encode()  # escapes can make lone surrogates, which cannot be printed: UnicodeEncodeError
        return super().construct_scalar(node)


for _tag in ("opencv-matrix", "opencv-nd-matrix"):
    _StrictLoader.add_constructor(f"tag:yaml.org,2002:{_tag}", _StrictLoader.construct_yaml_map)  # type: ignore[type-var]


def load_mapping(path: Path, hint: str) -> dict[Any, Any]:
    """The mapping that a YAML file holds; what OpenCV adds to YAML is understood.

    Raises ConfigurationError when the file cannot be read, is too long, is not a regular file or not YAML, has a key
    twice, or has no keys (then `hint` says what to write).
    """
    return parse_mapping(read_text(path, MOST_BYTES), path, hint)


def parse_mapping(text: str, path: Path, hint: str) -> dict[Any, Any]:
    """The mapping in the text of a YAML file; raises ConfigurationError as `load_mapping` does."""
    if _OF_OPENCV.match(text):
        text = _WITHOUT_BLANK.sub(r"\1: ", text)
    text = _VERSION.sub("#", text)
    try:
        _check_shape(text)
        documents = [document for document in yaml.load_all(text, _StrictLoader) if document is not None]
    except Exception as error:  # a parser's own mistakes among them
        raise ConfigurationError(f"{path}: is not valid YAML: {_reason(error, text)}") from error
    if len(documents) > 1:
        raise ConfigurationError(f"{path}: holds {len(documents)} documents, separated by ---: leave one")
    if not documents or not isinstance(documents[0], dict):
        raise ConfigurationError(f"{path}: has no keys: {hint}")
    return documents[0]


def _reason(error: Exception, text: str) -> str:
    """What is wrong with a text, and in which line, column and words, in one sentence."""
    match error:
        case yaml.MarkedYAMLError(problem=str(problem), problem_mark=mark) if mark is not None:
            line, column = mark.line, mark.column
            opened = error.context_mark  # where what is not closed begins
        case yaml.reader.ReaderError():
            before = _LINES.split(text.encode()[: error.position].decode(errors="ignore"))
            line, column, problem, opened = len(before) - 1, len(before[-1]), error.reason, None
        case _:
            return shortened(readable(" ".join(str(error).split())), _LONGEST_REASON)
    lines = _LINES.split(text)
    content = lines[line] if line < len(lines) else ""
    here = quoted(content[column]) if column < len(content) else "the end"
    plain = "indent with blanks, not with a tab" if here == _TAB else _PLAIN.get(problem)
    told = shortened(readable(problem), _LONGEST_REASON) if plain is None else plain.format(here=here)
    if opened is not None and (problem.startswith("did not find expected '") or "end of stream" in problem):
        line, column = opened.line, opened.column
        content = lines[line]
    excerpt = readable(content[max(column - _QUOTED_BEFORE, 0) : column + _QUOTED_AFTER].strip())
    return f"line {line + 1}, column {column + 1}{f', `{excerpt}`' if excerpt else ''}: {told}"


def _check_shape(text: str) -> None:
    """Refuse what would fill the stack or the memory; raises YAMLError."""
    depth = aliases = 0
    for event in yaml.parse(text, _StrictLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.AliasEvent):
            aliases += 1
        if depth > DEEPEST:
            raise yaml.YAMLError(_TOO_DEEP)
        if aliases > MOST_ALIASES:
            raise yaml.YAMLError(f"it has more than {MOST_ALIASES} aliases (*name): write out what they stand for")
