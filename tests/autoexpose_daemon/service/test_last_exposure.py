from __future__ import annotations

import json
import logging
import os
import time
from pathlib import Path

import pytest

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.service.last_exposure import FORMAT, LONGEST_AGE_S, LastExposure
from autoexpose_daemon.status.telemetry import GroupTally, Telemetry
from imaging.exposure import ExposureLimits, ExposureSetting

LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
SETTING = ExposureSetting(1234.5, 6.0)


def seen(setting: ExposureSetting = SETTING, saturated: float = 0.0, black: float = 0.0) -> Telemetry:
    decision = Decision(setting, setting.level, "", 0.0, saturated, black, 0.0)
    return Telemetry(applied=setting, groups={"all": GroupTally(decision=decision)})


def write(file: Path, **changes: object) -> None:
    content = {"format": FORMAT, "unix_time_s": time.time(), "exposure_time_us": 1234.5, "gain_db": 6.0}
    file.write_text(json.dumps(content | changes))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "last.json"


def test_the_next_process_begins_where_this_one_was(file: Path) -> None:
    LastExposure(file).keep(seen(), 0.0)
    assert LastExposure(file).recall(LIMITS) == SETTING
    assert [path.name for path in file.parent.iterdir()] == ["last.json"]


def test_without_a_file_it_is_remembered_within_the_process() -> None:
    last = LastExposure(None)
    assert last.recall(LIMITS) is None
    last.keep(seen(), 0.0)
    assert last.recall(LIMITS) == SETTING


@pytest.mark.parametrize("bad", [{"saturated": 0.6}, {"black": 0.6}])
def test_a_picture_that_shows_little_is_no_reason_to_remember(file: Path, bad: dict[str, float]) -> None:
    LastExposure(file).keep(seen(**bad), 0.0)
    assert not file.exists()


def test_an_exposure_without_a_new_frame_grows_old(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = time.time()
    monkeypatch.setattr("autoexpose_daemon.service.last_exposure.time.time", lambda: now_s)
    last, stopped = LastExposure(file), seen()
    last.keep(stopped, 0.0)
    now_s += LONGEST_AGE_S + 1.0
    last.keep(stopped, LONGEST_AGE_S)
    assert last.recall(LIMITS) is None
    last.keep(seen(), LONGEST_AGE_S)
    assert last.recall(LIMITS) == SETTING


def test_a_pipe_in_its_place_is_no_exposure(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    os.mkfifo(file)
    assert LastExposure(file).recall(LIMITS) is None
    assert "a named pipe, not a regular file" in caplog.text


def test_it_is_written_seldom(file: Path) -> None:
    last = LastExposure(file)
    last.keep(seen(), 0.0)
    file.unlink()
    last.keep(seen(ExposureSetting(2000.0, 0.0)), 4.0)
    last.keep(seen(), 300.0)  # as it was written
    assert not file.exists()
    last.keep(seen(ExposureSetting(2000.0, 0.0)), 310.0)
    assert file.exists()
    file.unlink()
    last.keep(seen(ExposureSetting(2000.0, 0.0)), 1000.0)  # unchanged, but it would grow old
    assert file.exists()


@pytest.mark.parametrize(
    ("changes", "damaged"),
    [
        *(({"unix_time_s": time.time() - age_s}, False) for age_s in (LONGEST_AGE_S + 60.0, -3600.0)),
        *(({"exposure_time_us": time_us}, False) for time_us in (8000.0, -1.0)),
        ({"gain_db": 31.0}, False),
        *((changes, True) for changes in ({"format": "other/1"}, {"gain_db": None}, {"gain_db": float("nan")})),
    ],
)
def test_one_of_another_time_out_of_bounds_or_damaged_is_not_used(
    file: Path, changes: dict[str, object], damaged: bool, caplog: pytest.LogCaptureFixture
) -> None:
    write(file, **changes)
    assert LastExposure(file).recall(LIMITS) is None
    assert ["damaged" in message for message in caplog.messages] == damaged * [True]


def test_it_grows_old_while_nothing_better_is_seen(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = time.time()
    monkeypatch.setattr("autoexpose_daemon.service.last_exposure.time.time", lambda: now_s)
    LastExposure(file).keep(seen(), 0.0)
    now_s += 0.9 * LONGEST_AGE_S
    last = LastExposure(file)
    assert last.recall(LIMITS) == SETTING
    last.keep(seen(black=0.9), 0.0)
    last.save(0.0)  # as every process does at its end
    now_s += 0.2 * LONGEST_AGE_S
    assert LastExposure(file).recall(LIMITS) is None
    assert last.recall(LIMITS) is None  # nor at a reload


def test_a_place_that_cannot_be_written_is_said_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    last = LastExposure(tmp_path / "missing" / "last.json")
    last.keep(seen(), 0.0)
    last.keep(seen(ExposureSetting(2000.0, 0.0)), 10.0)
    assert caplog.text.count("cannot be saved") == 1
    assert caplog.records[0].levelno == logging.WARNING


def test_systemd_says_where(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}:/elsewhere")
    LastExposure.in_state_directory().keep(seen(), 0.0)
    assert LastExposure(tmp_path / "last-exposure.json").recall(LIMITS) == SETTING
