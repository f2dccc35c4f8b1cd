"""The tool that tests the tests: what it changes, what it leaves alone, and that it notices what a test notices."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent

import pytest

from tests.mutation.operators import changes
from tests.mutation.relevance import Traced, function_at, function_lines, users
from tests.mutation.scope import LISTED, Mutant, listed, sample, sources
from tests.mutation.trial import DisturbedError, Fate, judge
from tests.mutation.workplace import Workplace

ROOT = Path(__file__).parents[2]


def mutations(source: str) -> list[str]:
    return [change.apply(source) for change in changes(source)]


@pytest.mark.parametrize(
    ("source", "mutants"),
    [
        ("a = 3", ["a = 4"]),
        ("a = 32", ["a = 64"]),
        ("a = 0.5", ["a = 1.0", "a = 0.25"]),
        ("a = True", ["a = False"]),
        ("a = -b", ["a = b"]),
        ("a = b - c * d", ["a = (b + c * d)", "a = b - (c / d)"]),
        ("a -= b", ["a += b"]),
        ("a = b < c <= d", ["a = (b >= c <= d)", "a = (b < c > d)"]),
        ("a = b is None and c", ["a = (b is None or c)", "a = (b is not None) and c"]),
        ("a = not b", ["a = b"]),
        ("a = b if c else d", ["a = b if (not c) else d"]),
        ("a = [b for b in c if b.d]", ["a = [b for b in c if (not b.d)]"]),
        ("a = min(b, np.argmax(c))", ["a = max(b, np.argmax(c))", "a = min(b, np.argmin(c))"]),
        ("def f():\n    return a", ["def f():\n    return None"]),
        ("é = 'é' if b else c[1]", ["é = 'é' if (not b) else c[1]", "é = 'é' if b else c[2]"]),
    ],
)
def test_one_thing_is_changed_at_a_time(source: str, mutants: list[str]) -> None:
    assert mutations(source) == mutants


@pytest.mark.parametrize(
    "source",
    [
        '"""Words, 3 of them."""',
        'def f():\n    """Never 1 of 2."""',
        "def f(a: Literal[1]) -> Literal[2]: pass",
        "a: Annotated[int, 3]",
        "@dataclass(frozen=True)\nclass A: pass",
        'raise ValueError(f"{1 + 2} of 3")',
        'log.info("%d of %d", 1 + a, 2)',
        'a = f"{b + 1:.3f}"',
        'a = b + " words"',
        "assert a < b",
        "a = zip(b, c, strict=True)",
        "a = None",
    ],
)
def test_words_and_types_are_left_alone(source: str) -> None:
    assert mutations(source) == []


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Some of our sources, among them those of what is listed."""
    some = (*(path for path, _, _ in LISTED), "drivers/triggers/", "calibration/response/")
    return {path: text for path, text in sources(ROOT).items() if path.startswith(some)}


def test_whatever_is_made_of_our_code_is_python(texts: dict[str, str]) -> None:
    for mutant in sample(texts, 300, 7):
        assert mutant.mutated != mutant.text
        compile(mutant.mutated, mutant.path, "exec")


def test_what_once_went_unnoticed_is_always_tried_and_the_sample_hangs_on_its_seed(texts: dict[str, str]) -> None:
    first, again, other = (sample(texts, 50, seed) for seed in (1, 1, 2))
    assert first == again
    assert [mutant.name for mutant in first] != [mutant.name for mutant in other]
    assert first[: len(LISTED)] == other[: len(LISTED)] == listed(texts)
    assert len(set(first)) == 50


CODE = dedent(
    """
    LIMIT = 3
    DOUBLE = 2 * LIMIT

    def low(a=LIMIT):
        return a < DOUBLE

    class Box:
        size: int = 4

        def full(self):
            def inner():
                return 1
            return inner()
    """
)


def test_lines_belong_to_the_innermost_function() -> None:
    lines = CODE.splitlines()
    at = {line.strip(): number for number, line in enumerate(lines, 1)}
    names = function_lines(CODE)
    assert names[at["return a < DOUBLE"]] == "low"
    assert names[at["return inner()"]] == "Box.full"
    assert names[at["return 1"]] == "Box.full.inner"
    assert at["LIMIT = 3"] not in names and at["def low(a=LIMIT):"] not in names
    assert function_at(CODE, at["def low(a=LIMIT):"]) == "low"
    assert function_at(CODE, at["size: int = 4"]) is None


def test_a_constant_is_felt_by_whoever_uses_it_or_what_is_made_of_it() -> None:
    user = "from rig.code import DOUBLE as TWICE\n\ndef high(): return TWICE\n\ndef none(): return 0\n"
    texts = {"rig/code.py": CODE, "rig/user.py": user}
    at = {line.strip(): number for number, line in enumerate(CODE.splitlines(), 1)}
    assert users(texts, "rig/code.py", at["LIMIT = 3"]) == {"rig/code.py:low", "rig/user.py:high"}
    assert users(texts, "rig/code.py", at["size: int = 4"]) == {"rig/code.py:Box.full", "rig/code.py:Box.full.inner"}


CODE_OF_IT = "def half(a):\n    return a / 2 + 0\n"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project of one function and three tests."""
    folder = tmp_path / "project"
    (folder / "tests").mkdir(parents=True)
    (folder / "code_of_it.py").write_text(CODE_OF_IT)
    (folder / "tests/test_half.py").write_text(
        "import os\nfrom code_of_it import half\n"
        "def test_zero(): assert half(0) == 0\n"
        "def test_four(): assert half(4) == 2\n"
        "def test_ended(): os.kill(os.getpid(), 9)\n"
    )
    return folder


def try_one(place: Workplace, after: str, *tests: str) -> Fate:
    change = next(change for change in changes(CODE_OF_IT) if change.after == after)
    related = [Traced(f"tests/test_half.py::test_{name}", 0.1, frozenset()) for name in tests]
    return judge(place, Mutant("it", "code_of_it.py", CODE_OF_IT, change), related)


def test_a_mutant_is_killed_by_the_test_that_notices_it_and_the_project_is_left_alone(project: Path) -> None:
    place = Workplace(project, project.parent / "place")
    divided, added = (try_one(place, after, "zero", "four") for after in ("(a * 2)", "(a / 2 - 0)"))
    assert (divided.kind, divided.by) == ("killed", "tests/test_half.py::test_four")
    assert (added.kind, added.by) == ("survived", None)
    assert (project / "code_of_it.py").read_text() == (place.root / "code_of_it.py").read_text() == CODE_OF_IT


def test_tests_that_something_else_ends_conclude_nothing(project: Path) -> None:
    with pytest.raises(DisturbedError, match="code_of_it"):
        try_one(Workplace(project, project.parent / "place"), "(a * 2)", "ended")
