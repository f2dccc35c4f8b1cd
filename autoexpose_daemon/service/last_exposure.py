"""The last good exposure, kept across restarts: after a crash the robot sees well from the first frame on."""

from __future__ import annotations

import json
import logging
import math
import os
import time
from pathlib import Path
from typing import NamedTuple

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.status.telemetry import Telemetry
from documents.files import read_regular
from imaging.exposure import ExposureLimits, ExposureSetting

log = logging.getLogger(__name__)

FORMAT = "autoexpose-last-exposure/1"
LONGEST_AGE_S = 3600.0
"""After an hour the light has changed, and the configured start is as good a guess."""
_MOST_BYTES = 1 << 12  # it has about 100
_WRITE_PERIOD_S = 5.0
_REFRESH_PERIOD_S = 600.0
_CLOCK_STEP_S = 5.0  # the wall clock may have been set back by this much meanwhile
_GOOD_SHARE = 0.5  # an image half black or half saturated says little about the right exposure


class _Seen(NamedTuple):
    """An exposure, and when a frame was well exposed with it, by the wall clock."""

    setting: ExposureSetting
    unix_time_s: float


class LastExposure:
    """Remembers the last good exposure, and keeps it in a file if one is named.

    A file that is too old, damaged or not writable costs a log line and nothing else.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self._seen: _Seen | None = None
        self._newest: Decision | None = None  # judged last: without frames nothing new is seen
        self._written: ExposureSetting | None = None
        self._written_s = -math.inf
        self._said_unwritable = False

    @classmethod
    def in_state_directory(cls) -> LastExposure:
        """In the state directory that systemd gives the service; in memory only without one."""
        folder = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
        return cls(Path(folder) / "last-exposure.json" if folder else None)

    def recall(self, limits: ExposureLimits) -> ExposureSetting | None:
        """The last good exposure, from memory or file; None without a reliable one within `limits`."""
        if self._seen is None and self._file is not None:
            self._seen = _read(self._file)
        if self._seen is None or not limits.contain(self._seen.setting):
            return None
        age_s = time.time() - self._seen.unix_time_s
        if not -_CLOCK_STEP_S <= age_s <= LONGEST_AGE_S:
            log.info("the last exposure is %.0f s old, starting with the configured one", age_s)
            return None
        return self._seen.setting

    def keep(self, telemetry: Telemetry, now_s: float) -> None:
        """Remember the setting of the newest frame if it was well exposed; save a changed one at most every 5 s.

        `now_s` is from a monotonic clock.
        """
        decision, applied = telemetry.decision, telemetry.applied
        if decision is None or applied is None or decision is self._newest:
            return
        self._newest = decision
        if max(decision.saturated_share, decision.black_share) > _GOOD_SHARE:
            return
        self._seen = _Seen(applied, time.time())
        age_s = now_s - self._written_s
        changed = self._written is None or not applied.agrees_with(self._written)
        if age_s > (_WRITE_PERIOD_S if changed else _REFRESH_PERIOD_S):
            self.save(now_s)

    def save(self, now_s: float) -> None:
        """Write the remembered exposure to the file, atomically."""
        if self._file is None or self._seen is None:
            return
        setting, unix_time_s = self._seen
        self._written, self._written_s = setting, now_s
        content = {
            "format": FORMAT,
            "unix_time_s": round(unix_time_s, 3),
            "exposure_time_us": setting.exposure_time_us,
            "gain_db": setting.gain_db,
        }
        part = self._file.with_suffix(".part")
        try:
            part.write_text(json.dumps(content) + "\n")
            part.replace(self._file)
        except OSError as error:
            if not self._said_unwritable:
                log.warning("the last exposure cannot be saved for a restart: %s", error)
            self._said_unwritable = True


def _read(file: Path) -> _Seen | None:
    try:
        content = json.loads(read_regular(file, _MOST_BYTES))
        if content["format"] != FORMAT:
            raise ValueError(f"format is {content['format']!r}")
        unix_time_s = float(content["unix_time_s"])
        setting = ExposureSetting(float(content["exposure_time_us"]), float(content["gain_db"]))
        if not all(map(math.isfinite, (setting.exposure_time_us, setting.gain_db, unix_time_s))):
            raise ValueError("it is not finite")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
        log.warning("%s is damaged, starting with the configured exposure: %s: %s", file, type(error).__name__, error)
        return None
    return _Seen(setting, unix_time_s)
