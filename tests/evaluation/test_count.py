"""What `autoexpose arena --count` counts, on sources whose counts are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arena import count
from evaluation.arena.arena_app import arena_app as app
from evaluation.arena.count import Count, c_files, count_c, count_python, python_files, snapshot_fields
from imaging.errors import ConfigurationError


@pytest.mark.parametrize(
    ("source", "numbers", "branches"),
    [
        ('"""3 if 4."""\n# 5 while 6\nX = "7 if 8"', 0, 0),
        ("x = (0, 1, 2, -1, 0.0, 1.0, 2.0, True, None)", 0, 0),
        ("x = (3, -2.5, 1e-3, 0x10, 3j)", 4, 0),  # a complex number is no constant of a decision
        ("if a and b or c:\n    x\nelif d:\n    y\nelse:\n    z", 0, 2),
        ("while a:\n    x\nfor b in c:\n    y\ntry:\n    assert d\nexcept E:\n    z", 0, 1),
        ("x = a if b else c if d else e", 0, 2),
        ("x = [a for b in c for d in e if f if g]\ny = lambda: 7 if h else 8", 2, 3),
        ("match a:\n    case 5:\n        x\n    case [b] if b:\n        y\n    case _:\n        z", 1, 2),
    ],
)
def test_python(source: str, numbers: int, branches: int) -> None:
    assert count_python(source) == Count(numbers, branches)


@pytest.mark.parametrize(
    ("source", "numbers", "branches"),
    [
        ("// 3 if\n/* 4\n * while 5 */\nchar *s = \"6 ? \\\" 7\", c = '8', d = '\\'';", 0, 0),
        ("x = 0 + 1 + 2 - 1 + 0u + 1UL + 2.0f + 0.f + .0 + 0x1 + 1.;", 0, 0),
        ("x = 3 + 10 + 0x10u + 1e-3f + .5 + 2.5 + 20 + 1.01 + 0x1p-4 + 12L;", 10, 0),
        ("x2 = uint8_t + a16[b3];", 0, 0),
        ('#include "a9.h"\n#if X > 7 && \\\n    Y > 8\n#  define N 9\n#elif Z > 3\n#endif', 1, 0),
        ("if (a && b) x; else if (c) y; else z;", 0, 2),
        ("do { x; } while (a); while (b) y; for (;;) z;", 0, 2),
        ("switch (a) { case 5: x; case B: y; default: z; }", 1, 2),
        ("x = a ? b : c ? 4 : 5;", 2, 2),
    ],
)
def test_c(source: str, numbers: int, branches: int) -> None:
    assert count_c(source) == Count(numbers, branches)


def test_follows_imports_within_its_scope_and_the_calls_into_c(tmp_path: Path) -> None:
    control = "autoexpose_daemon/control"
    sources = {
        f"{control}/loop.py": "from autoexpose_daemon.control.policies import table",
        f"{control}/policies/__init__.py": "",
        f"{control}/policies/table.py": "from imaging.errors import Error",
        f"{control}/policies/belief/policy.py": """
from typing import TYPE_CHECKING
from autoexpose_daemon.control import _native
from imaging.response import Response
import imaging.exposure
if TYPE_CHECKING:
    from autoexpose_daemon.control.unreached import Type
def decide():
    from autoexpose_daemon.control.late import late
    _native.sum_of(3)
""",
        f"{control}/late.py": "",
        f"{control}/unreached.py": "X = 3",
        f"{control}/policies/published/fixed.py": "X = 3",
        "imaging/__init__.py": "",
        "imaging/response.py": "",
        "imaging/exposure.py": "",
        "imaging/errors.py": "X = 3",
        f"{control}/native/bindings.c": '#include <math.h>\n#include "sums.h"\nX = { "sum_of", f, 0 };',
        f"{control}/native/sums.h": '#include "image.h"',
        f"{control}/native/sums.c": '#include "sums.h"',
        f"{control}/native/image.h": "",
        f"{control}/native/others.c": '#include "image.h"\nX = {"product_of", f, 0};',
    }
    for name, source in sources.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(source)
    python = python_files(DEFAULT_POLICY, tmp_path)
    assert set(python) == {
        "autoexpose_daemon.control.loop",
        "autoexpose_daemon.control.policies.table",
        "autoexpose_daemon.control.policies.belief.policy",
        "autoexpose_daemon.control.late",
        "imaging.response",
        "imaging.exposure",
    }
    assert [path.name for path in c_files(list(python.values()), tmp_path)] == [
        *("bindings.c", "image.h", "sums.c", "sums.h")
    ]
    with pytest.raises(ConfigurationError, match="checkout"):
        c_files([], tmp_path / "installed")


def test_fields_of_a_snapshot_have_names() -> None:
    state = {
        "level": 1.0,
        "past": [{"level": 1.0, "pair": [1, 2]}, {"level": 2.0, "pair": [3, 4]}],
        "views": {"left": {"curve": np.zeros(9)}, "right": {"curve": np.zeros(9)}},
        "served": {"left": 0.5, "waited": 3},  # a field that is called left, not a camera
        "nothing": None,
        "empty": [],
    }
    assert len(snapshot_fields(state)) == 1 + 2 + 1 + 2 + 1 + 1


def test_a_snapshot_is_of_the_policy() -> None:
    stateless, stateful = (snapshot_fields(count.snapshot_of(policy, frames=1)) for policy in ("fixed", "shin2019"))
    assert len(stateless) < len(stateful)


def test_command_counts_the_default_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(count, "snapshot_of", lambda policy: {"level": 1.0, "target": None})
    result = CliRunner().invoke(app, ["--count", "--json", str(tmp_path / "count.json")])
    assert result.exit_code == 0, result.output
    counts = json.loads((tmp_path / "count.json").read_text())
    assert (counts["policy"], counts["snapshot_fields"]) == (DEFAULT_POLICY, 2)
    files = {each["file"]: each for each in counts["files"]}
    assert {"autoexpose_daemon/control/loop.py", "imaging/exposure.py"} < set(files)
    assert any(name.endswith(".c") for name in files) and not any("published" in name for name in files)
    for what in ("numbers", "branches"):
        assert counts[what] == sum(each[what] for each in counts["files"])
        assert str(counts[what]) in result.output


@pytest.mark.parametrize(
    "options",
    [["--count", "--quick"], ["--count", "--ablate"], ["--ablate", "--full"], ["--ablate", "--policies", "fixed"]],
)
def test_counting_and_ablating_go_alone(options: list[str]) -> None:
    with pytest.raises(ConfigurationError, match="leave the others out"):
        app(options, standalone_mode=False)
