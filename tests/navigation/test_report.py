"""`autoexpose map report`: what a map went through, as a page."""

from __future__ import annotations

import errno
import json
import math
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from navigation.commands import map_app
from navigation.drive.repeat import Repeater
from navigation.maps.path import Velocity
from navigation.report import Findings, _draw_path, findings
from navigation.store import MapError, MapFile, MapInfo
from tests.navigation.test_repetition import pair, teach_wall, view

LENGTH_M, DRIVES = 2.0, 6


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A quarter of a circle of 2 m, driven six times; from the second drive on its end looks different."""
    turn_rad_s = 0.5 * math.pi / 2 / LENGTH_M
    path = teach_wall(tmp_path_factory.mktemp("maps") / "lap.map", LENGTH_M, Velocity(0.5, turn_rad_s))
    for drive in range(DRIVES):
        with MapFile(path, writable=True) as file:
            repeater = Repeater(file, "adaptive")
            for number in range(41):
                shift_px = 200 if drive and number > 30 else 10 * drive
                repeater.look(pair(view(shift_px), number), number / 20)
    return path


@pytest.fixture(scope="module")
def found(driven: Path) -> Findings:
    with MapFile(driven) as file:
        return findings(file)


def test_the_path_is_drawn_as_it_was_driven(found: Findings) -> None:
    radius_m = LENGTH_M / (math.pi / 2)
    assert found.plan_m[0].tolist() == [0.0, 0.0]
    assert found.plan_m[-1] == pytest.approx([-radius_m, radius_m], abs=0.05)  # ahead is up, and it turns left
    assert found.marks_m[0].tolist() == [0.0, 0.0]
    assert np.hypot(*np.diff(found.marks_m, axis=0).T) == pytest.approx(0.2, abs=0.051)


def test_a_path_that_was_driven_backwards_is_drawn_behind_the_start(tmp_path: Path) -> None:
    with MapFile(tmp_path / "lap.map", MapInfo(720, 540, 600.0, "fast-orb", "")) as file:
        file.begin_run("teach", 0.0)
        file.add_speeds([(0.0, -0.5, 0.5 * math.pi / 2 / LENGTH_M), (LENGTH_M, 0.0, 0.0)])
        plan_m = findings(file).plan_m
    radius_m = LENGTH_M / (math.pi / 2)
    assert plan_m[-1] == pytest.approx([radius_m, -radius_m], abs=0.05)  # its front turns left, so its back goes right


def test_each_passing_has_its_share_of_features_seen_again(found: Findings) -> None:
    assert found.seen_share.shape == (DRIVES, len(found.marks_m))
    assert np.isnan(found.seen_share[:, -1]).all()  # never left behind
    assert found.seen_share[0, :-1].min() > 0.9
    assert np.nanmin(found.seen_share[1]) < 0.75


def test_what_was_taught_gives_way_to_what_is_new(found: Findings) -> None:
    assert (found.total == found.taught).all()  # adaptive maps keep their size
    assert (np.diff(found.kept) <= 0).all()
    assert found.kept[-1] < found.taught


def test_models_are_judged_by_the_last_passing(found: Findings) -> None:
    by_model = {one.model: one for one in found.foretold}
    assert 0.0 <= by_model["fremen"].brier < 0.25
    assert by_model["mean"].foretold.shape == by_model["mean"].seen.shape
    assert math.isnan(by_model["score-sum"].brier)  # no probability


def test_the_command_writes_a_page_that_needs_nothing_else(driven: Path, tmp_path: Path) -> None:
    page = tmp_path / "lap.html"
    result = CliRunner().invoke(map_app, ["report", str(driven), str(page)])
    assert result.exit_code == 0, result.output
    text = page.read_text()
    assert text.count("<figure>") == 4
    assert "repeated</th><td>6 times" in text
    assert not re.search(r'(src|href)="(?!data:)', text)


def test_info_is_a_few_lines(driven: Path) -> None:
    result = CliRunner().invoke(map_app, ["info", str(driven)])
    assert result.exit_code == 0, result.output
    assert re.search(r"^path +2\.0 m, \d+ local maps", result.output, re.MULTILINE)
    assert "repeated  6 times" in result.output
    as_json = json.loads(CliRunner().invoke(map_app, ["info", str(driven), "--json"]).stdout)
    assert as_json["repeated"].startswith("6 times")


def test_list_is_a_row_for_each_local_map(driven: Path) -> None:
    head, *rows = CliRunner().invoke(map_app, ["list", str(driven)]).stdout.splitlines()
    places = json.loads(CliRunner().invoke(map_app, ["list", str(driven), "--json"]).stdout)["places"]
    assert head.split()[:2] == ["number", "m"]
    assert [row.split()[:2] for row in rows] == [[str(place["number"]), str(place["m"])] for place in places]
    assert any(place["passed"] >= 1 for place in places)


def test_what_happened_once_or_never_varied_is_said_so(tmp_path: Path) -> None:
    path = teach_wall(tmp_path / "lap.map", 1.0, Velocity(0.5, 0.0))
    with MapFile(path, writable=True) as file:
        file.begin_run("repeat", 0.0)
    said = CliRunner().invoke(map_app, ["info", str(path)]).output
    assert "repeated  once, 1970-01-01" in said
    assert "1000 us, 6.0 dB" in said


@pytest.mark.parametrize("turned", [False, True])
def test_a_straight_path_is_drawn_with_room_on_both_sides(found: Findings, turned: bool) -> None:
    along = np.column_stack([np.zeros(5), np.arange(5.0)])[:, :: -1 if turned else 1]
    axes = Figure().subplots()
    _draw_path(axes, replace(found, plan_m=along, marks_m=along, runs=[]))
    for low, high in (axes.get_xlim(), axes.get_ylim()):
        assert high - low >= 4.0


def test_an_export_to_a_full_disk_ends_in_a_sentence(
    driven: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full_disk(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    result = CliRunner().invoke(map_app, ["export", str(driven), str(tmp_path / "out")])
    assert isinstance(result.exception, MapError)
    assert str(result.exception).endswith("0000.png cannot be written: No space left on device")


def test_a_map_that_was_never_repeated_has_a_page_too(tmp_path: Path) -> None:
    path, page = tmp_path / "new.map", tmp_path / "new.html"
    MapFile(path, MapInfo(720, 540, 600.0, "fast-orb", "")).close()
    result = CliRunner().invoke(map_app, ["report", str(path), str(page)])
    assert result.exit_code == 0, result.output
    assert page.read_text().count("<figure>") == 1
