"""The YAML that users' files hold: what is read of it, and what is refused in one short sentence."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from documents.strict_yaml import MOST_BYTES, load_mapping
from documents.text import LONGEST_QUOTE, quoted, shortened
from imaging.errors import ConfigurationError


def load(tmp_path: Path, content: bytes) -> object:
    file = tmp_path / "a.yaml"
    file.write_bytes(content)
    return load_mapping(file, "begin with `a:`")


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML was built without libyaml")
def test_a_tab_before_a_comment_is_read(tmp_path: Path) -> None:
    assert load(tmp_path, b"a: 1\t# one\nb: [1,\n\t2]\n") == {"a": 1, "b": [1, 2]}


@pytest.mark.parametrize(
    "text",
    [
        "%YAML:1.0\na: 1\n",
        "%YAML:1.0\n---\na: 1\n",
        "%YAML 1.2\n---\na: 1\n...\n",
        "%YAML 1.0\n---\na: 1\n",
        "\n%YAML:1.0 # first\na: 1\n",
        "a: 1\n---\n",
        "---\na: 1\r\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_document_is_read_whatever_begins_and_ends_it(tmp_path: Path, text: str, encoding: str) -> None:
    assert load(tmp_path, text.encode(encoding)) == {"a": 1}


def test_a_matrix_of_opencv_is_a_mapping(tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(tmp_path / "b.yml"), cv2.FileStorage_WRITE)
    storage.write("k", np.eye(2))
    storage.write("t", np.array([1.0, 2.0]))
    storage.release()
    read = load(tmp_path, (tmp_path / "b.yml").read_bytes())
    assert isinstance(read, dict)
    assert read["k"] == {"rows": 2, "cols": 2, "dt": "d", "data": [1.0, 0.0, 0.0, 1.0]}
    assert read["t"]["data"] == [1.0, 2.0]


def test_opencvs_dialect_needs_no_blank_after_a_key(tmp_path: Path) -> None:
    text = b"%YAML:1.0\na:[1, 2]\nb.c:2\nd: x:y\ne: http://f\n"
    assert load(tmp_path, text) == {"a": [1, 2], "b.c": 2, "d": "x:y", "e": "http://f"}
    with pytest.raises(ConfigurationError):
        load(tmp_path, b"a:[1, 2]\nb.c: 2\n")


@pytest.mark.parametrize(
    ("content", "place", "words"),
    [
        ("a: {b: {c: 1}\n", "line 1, column 4, `a: {b: {c: 1}`", "the { is not closed"),
        ("a:\n  b: [1, 2\n  c: 3\n", "line 2, column 6, `b: [1, 2`", "the [ is not closed"),
        ('a: 1\nb: "c\n', 'line 2, column 4, `b: "c`', "not closed"),
        ("a:\n\tb: 1\n", "line 2, column 1, `b: 1`", "tab"),
        ("a: @b\n", "line 1, column 4, `a: @b`", "'@'"),
        ("a: 1\n# two\n b: 2\n", "line 3, column 2, `b: 2`", "neither a key"),
        ("a: 1\nb: *c\n", "line 2, column 4, `b: *c`", "quotes"),
        ("a: 2026-13-01\n", "line 1, column 4, `a: 2026-13-01`", "month"),
        ("a:\n- 1\n- !!int x\n", "line 3, column 3, `- !!int x`", "'x'"),
        ("# \u00e4\na: \x07\n", "line 2, column 4, `a: \\x07`", "control characters"),
        ("a: " + "x" * 200 + ": b: c\n", "line 1, column 204, `", "quotes"),
    ],
)
def test_a_slip_is_named_by_line_and_column_and_quoted(tmp_path: Path, content: str, place: str, words: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, content.encode())
    said = str(caught.value)
    assert place in said
    assert words in said
    assert "unicode string" not in said and "\n" not in said


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a: 1\na: 2\n", "the key 'a' appears twice, the second time in line 2"),
        (b"a: {b: 1, c: 2, b: 3}\n", "the key 'b' appears twice"),
        (b"k" * 400 + b": 1\n" + b"k" * 400 + b": 1\n", "appears twice"),
        (b"a: &x [1]\nb: [" + b"*x, " * 17 + b"]\n", "more than 16 aliases"),
        (b"a: " + b"[" * 100_000, "nested deeper than 64 levels"),
        (b"a: 1\n---\nb: 2\n", "holds 2 documents"),
        (b"a: !!python/object:os.system {}\n", "is not valid YAML: line 1, column 4, `a: "),
        (b"a: " + b"'" + b"x" * 100_000, "is not valid YAML: line 1, column 4, `a: "),
        (b"a: !!int " + b"x" * 100_000, "is not valid YAML: line 1, column 4, `a: "),
        (b"\x89PNG\r\n", "is not text"),
        (b"\xff\xfea", "is not text"),
        (b"a: \x01\n", "is not valid YAML: line 1, column 4, `a: "),
        (b"", "has no keys: begin with `a:`"),
        (b"just words\n", "has no keys"),
        (b"#" * (MOST_BYTES + 1), "cannot be read (longer than 1024 KiB)"),
    ],
)
def test_what_is_wrong_is_said_in_one_short_sentence(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, content)
    said = str(caught.value).removeprefix(str(tmp_path))
    assert words in said
    assert said.startswith("/a.yaml: ")
    assert "\n" not in said
    assert len(said) < 300


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="a directory, not a regular file"):
        load_mapping(tmp_path, "")


@pytest.mark.parametrize(
    "value", ["x" * 100_000, [["y" * 999] * 999] * 999, {"z" * 999: 1}, 10**4000, "\x1b\u200b" * 99]
)
def test_an_error_quotes_a_few_characters_of_what_somebody_wrote(value: object) -> None:
    assert len(quoted(value)) <= LONGEST_QUOTE
    assert quoted(value).isprintable()


def test_short_texts_are_quoted_whole() -> None:
    assert quoted("SN-1") == "'SN-1'"
    assert quoted([720, 540]) == "[720, 540]"
    assert shortened("a" * LONGEST_QUOTE) == "a" * LONGEST_QUOTE
