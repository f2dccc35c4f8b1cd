"""What a decision rests on, made up: a room, and a window that is guessed."""

from __future__ import annotations

from autoexpose_daemon.control.decision import Grounds, SceneHistogram

GROUNDS = Grounds(
    scenes={
        "left": SceneHistogram(
            start=-16.0,
            bin_stops=1.0,
            known=[0.0, 0.1, 0.3, 0.2, 0.0, 0.0, 0.0, 0.0],
            guessed=[0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.15, 0.05],
            contrast=[0.0, 0.1, 0.2, 0.3, 0.0, 0.2, 0.1, 0.1],
            black=-19.5,
            white=-12.0,
        )
    },
    level=12.0,
    levels=[6.0, 8.0, 10.0, 12.0, 14.0],
    worth=[0.3, 1.0, 0.6, 0.8, 0.2],
    value=[6.2, 7.3, 6.5, 7.1, 6.1],
)
