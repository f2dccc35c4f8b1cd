"""The picture in docs/ of what the policy `belief` knows and decides by, as a window comes into view.

python -m tools.belief_picture FILE; `make pictures` puts it there."""

from __future__ import annotations

import sys
from pathlib import Path

from autoexpose_daemon.recording.belief_plot import Moment, draw
from evaluation.arena.race import course_of
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import Entrant
from imaging.exposure import ExposureSetting

COURSE = "pan", "room", 1
DELAY_FRAMES, MOMENTS = 2, 4
LEAP_STOPS = 2.0  # By so much the exposure falls when the window is looked at


def moments() -> list[Moment]:
    """The first leap, and the frames that show where it led to."""
    stage, _ = course_of(*COURSE)
    delayed = Entrant.of("belief", DELAY_FRAMES).enter(ExposureSetting(7500.0, 20.0))
    found: list[Moment] = []
    frame, due = 0, -1
    while len(found) < MOMENTS:
        stage.go_to(frame)
        pair = delayed.step(stage.take)
        decision, grounds = delayed.decisions[-1], delayed.loop.grounds
        leaps = not found and pair.reference.setting.level - decision.level > LEAP_STOPS
        if grounds is not None and (leaps or frame == due):
            words = f"{frame / RATE_HZ:.2f} s: {pair.reference.setting}\n{decision.reason}"
            found.append(Moment(words, pair.reference.grey8(), grounds.scenes["left"], grounds, decision.level))
            due = frame + DELAY_FRAMES
        frame += 1
    return found


if __name__ == "__main__":
    title = "A window comes into view: its light is guessed, looked at, and exposed for"
    draw(Path(sys.argv[1]), moments(), title)
