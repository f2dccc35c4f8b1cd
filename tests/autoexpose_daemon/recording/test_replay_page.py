"""A replay as a page and as JSON: all that was recorded, beside what was decided again."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from autoexpose_daemon.cli import app
from imaging.errors import ConfigurationError
from tests.autoexpose_daemon.recording.runs import VirtualRun, record


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("run") / "run.mcap", VirtualRun("belief"))


@pytest.mark.parametrize("policy", [None, "neves2009"])
def test_every_step_is_in_the_json_and_the_page_shows_both(recording: Path, policy: str | None, tmp_path: Path) -> None:
    figures, page = tmp_path / "f.json", tmp_path / "p.html"
    chosen = [] if policy is None else ["--policy", policy]
    outcome = CliRunner().invoke(app, ["replay", str(recording), *chosen, "--json", str(figures), "--html", str(page)])
    assert outcome.exit_code == 0, outcome.exception
    written = json.loads(figures.read_text())
    assert (written["recorded_policy"], written["replayed_policy"]) == ("belief", policy or "belief")
    steps = written["steps"]
    assert f"{len(steps)} steps" in outcome.output
    assert [step["trigger"] for step in steps] == list(range(steps[0]["trigger"], steps[0]["trigger"] + len(steps)))
    assert all(step["cameras"].keys() == {"left", "right"} for step in steps)
    if policy is None:
        assert all(step["same"] and step["recorded"] == step["replayed"] for step in steps[1:])
    else:
        assert any(step["recorded"]["level"] != step["replayed"]["level"] for step in steps)
    text = page.read_text()
    assert len(re.findall('<img src="data:image/jpeg', text)) >= 2
    assert text.count('class="recorded"') == text.count('class="replayed"') == 3
    assert ("data:image/png" in text) == (policy is None)  # the belief, of who has one
    assert steps[-1]["recorded"]["reason"].split(";")[0] in text
    assert "http" not in text


def test_a_recording_is_never_replaced(recording: Path) -> None:
    content = recording.read_bytes()
    for option, suffix in (("--html", ".html"), ("--json", ".json")):
        outcome = CliRunner().invoke(app, ["replay", str(recording), option, str(recording)])
        assert isinstance(outcome.exception, ConfigurationError) and suffix in str(outcome.exception)
    assert recording.read_bytes() == content
