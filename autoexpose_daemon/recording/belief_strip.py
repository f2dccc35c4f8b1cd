"""The moments of a replay at which the belief of its policy is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from autoexpose_daemon.recording.belief_plot import Moment, draw
from autoexpose_daemon.recording.replay import Replay, Replayed
from documents.files import check_writable
from imaging.errors import ConfigurationError

MOST_MOMENTS = 8
"""In one picture."""

_STRIP = 4
_OTHER_STOPS = 0.25
"""Exposures, and changes of them, that differ by less count as the same."""


class BeliefStrip:
    """Watches a replay (see `report_replay`) and keeps the moments to be drawn.

    Parameters
    ----------
    path
        The PNG file to write.
    triggers
        Of the decisions to draw. Without any it is the one that changes the exposure most, and then the first frames
        of each exposure that it led to, four moments in all.

    Raises
    ------
    ConfigurationError
        When no picture can be drawn; from `see` and `draw`, too.
    """

    def __init__(self, path: Path, triggers: Sequence[int]) -> None:
        check_writable(path)
        if len(triggers) > MOST_MOMENTS:
            raise ConfigurationError(
                f"{len(triggers)} triggers are too many for one picture: give --at at most {MOST_MOMENTS} times"
            )
        self._path = path
        self._triggers = triggers
        self._kept: list[tuple[int, Moment]] = []
        self._largest = 0.0
        self._start_ns: int | None = None

    def see(self, player: Replay, replayed: Replayed) -> None:
        """Keep this moment if it is to be drawn."""
        pair, decision, loop = replayed.step.pair, replayed.decision, player.loop
        frame = pair.reference
        if self._start_ns is None:
            self._start_ns = frame.host_time_ns
        if decision is None or loop is None or replayed.step.override.unseen:
            return
        if not self._wants(pair.trigger, frame.setting.level, decision.level):
            return
        grounds = loop.grounds
        if grounds is None:
            policy_id = loop.setup.policy_id
            raise ConfigurationError(f"policy {policy_id} has no belief to show: replay with --policy belief")
        scene = grounds.scenes.get(pair.reference_side)
        if scene is None:  # nothing is known of this camera
            return
        seconds = (frame.host_time_ns - self._start_ns) * 1e-9
        words = f"{seconds:.2f} s, trigger {pair.trigger}: {frame.setting}\n{decision.reason}"
        picture = frame.grey8(loop.setup.responses[pair.reference_side].saturation)
        self._kept.append((pair.trigger, Moment(words, picture, scene, grounds, decision.level)))

    def draw(self) -> str:
        """Draw what was kept, and return what that is, in words."""
        triggers = [trigger for trigger, _ in self._kept]
        missing = [trigger for trigger in self._triggers if trigger not in triggers]
        if missing or not triggers:
            which = f"on trigger {missing[0]} " if missing else ""
            raise ConfigurationError(f"no decision {which}was replayed with a belief to show")
        draw(self._path, [moment for _, moment in self._kept], "The belief that decides")
        return f"belief at trigger {', '.join(map(str, triggers))}: {self._path}"

    def _wants(self, trigger: int, level: float, decided_level: float) -> bool:
        if self._triggers:
            return trigger in self._triggers
        change = abs(decided_level - level)
        if not self._kept or change > self._largest + _OTHER_STOPS:
            self._largest = change
            self._kept.clear()
            return True
        _, newest = self._kept[-1]
        return len(self._kept) < _STRIP and abs(level - newest.grounds.level) > _OTHER_STOPS
