"""A policy's belief as a picture: the light of the scene, what a frame shows of it, and what exposures promise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Grounds, SceneHistogram
from autoexpose_daemon.recording.replay import Replay, Replayed
from documents.files import check_writable
from imaging.errors import ConfigurationError

_KNOWN, _GUESSED, _CONTRAST, _WORTH = "#79a6cc", "#8f9aa5", "#b5543c", "#dfe3e8"
_NOW, _NEXT, _SHOWN = "#1d4e89", "#e07b00", "#fff3c9"
_TICK_STOPS, _MARGIN_STOPS = 4.0, 1.0
_HELD_STOPS = 0.05
"""Cameras round what is decided by less."""

_COLUMN_IN, _HEIGHT_IN = 4.0, 8.2
_STYLE: dict[Any, Any] = {
    "font.size": 12,
    "axes.titlesize": 12,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "hatch.color": _GUESSED,
    "hatch.linewidth": 0.8,
}


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One decision to be drawn."""

    words: str  # when it was, and what for
    picture: NDArray[np.uint8]  # the frame that it was made on, grey, uint8, shape (height, width)
    scene: SceneHistogram  # what is believed of the light that its camera faces
    grounds: Grounds  # what the decision rests on
    decided_level: float  # what was decided, stops


def draw(path: Path, moments: Sequence[Moment], title: str) -> None:
    """Draw moments side by side into a PNG file, all on the same axes."""
    mpl.use("Agg")
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(_COLUMN_IN * len(moments) + 0.3, _HEIGHT_IN), layout="constrained")
        figure.suptitle(title, fontsize=15)
        frames, scenes, promises = figure.subplots(3, len(moments), squeeze=False, height_ratios=[2.3, 2.6, 2.0])
        for place, moment in enumerate(moments):
            scenes[place].sharey(scenes[0])
            promises[place].sharey(promises[0])
            _draw_frame(frames[place], moment)
            _draw_scene(scenes[place], moment)
            _draw_promise(promises[place], moment)
            for axes in (scenes[place], promises[place]):
                _share_stops(axes, moment, _range(moments))
        scenes[0].set_ylabel("share of the picture")
        promises[0].set_ylabel("worth of the next frames")
        named = [*scenes[0].get_legend_handles_labels()[0], *promises[0].get_legend_handles_labels()[0]]
        figure.legend(handles=named, loc="outside lower center", ncols=min(len(moments), 3), frameon=False)
        figure.savefig(path, format="png", dpi=100)  # whatever the name ends in


def _range(moments: Sequence[Moment]) -> tuple[float, float]:
    """Radiance of which all moments together have something to say."""
    scenes = [moment.scene for moment in moments]
    bounds = [bound for scene in scenes for bound in (scene.black, scene.white, *_visible_bins(scene))]
    return min(bounds) - _MARGIN_STOPS, max(bounds) + _MARGIN_STOPS


def _visible_bins(scene: SceneHistogram) -> NDArray[np.float64]:
    """Lower bounds of the bins that are high enough to be seen in a picture."""
    heights = np.array(scene.known) + scene.guessed
    return np.asarray(scene.start + scene.bin_stops * np.flatnonzero(heights > 0.02 * heights.max()))


def _share_stops(axes: Axes, moment: Moment, shown: tuple[float, float]) -> None:
    """The axis that histogram and exposure levels share: each level where the middle of what its frame shows lies."""
    grounds = moment.grounds
    ticks = _TICK_STOPS * np.arange(np.ceil(grounds.levels[0] / _TICK_STOPS), grounds.levels[-1] // _TICK_STOPS + 1)
    axes.set_xticks(_middle(moment) - ticks, [f"{level:g}" for level in ticks])
    axes.set_xlim(shown)
    axes.grid(visible=True, axis="x", color="#e6e9ec", lw=0.7)
    axes.set_axisbelow(True)


def _middle(moment: Moment) -> float:
    """Radiance in the middle of what a frame of level 0 would show."""
    return (moment.scene.black + moment.scene.white) / 2 + moment.grounds.level


def _draw_frame(axes: Axes, moment: Moment) -> None:
    axes.imshow(moment.picture, cmap="gray", vmin=0, vmax=255, aspect="equal")
    axes.set_title(moment.words)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set(visible=True, color=_GUESSED)


def _draw_scene(axes: Axes, moment: Moment) -> None:
    """The histogram, with what this frame shows of it, and the next one will."""
    scene = moment.scene
    known, guessed = np.array(scene.known), np.array(scene.guessed)
    edges = scene.start + scene.bin_stops * np.arange(known.size + 1)
    axes.axvspan(scene.black, scene.white, color=_SHOWN, lw=0, zorder=0, label="what this frame can show")
    axes.stairs(known, edges, fill=True, color=_KNOWN, label="seen, now or before")
    hatched: dict[str, Any] = {"hatch": "//////", "facecolor": "none", "edgecolor": _GUESSED, "lw": 0.0}
    axes.stairs(known + guessed, edges, baseline=known, fill=True, label="clipped so far: a guess", **hatched)
    axes.stairs(scene.contrast, edges, color=_CONTRAST, lw=1.6, label="contrast in it")
    moved = moment.grounds.level - moment.decided_level
    held = abs(moved) < _HELD_STOPS
    _draw_window(axes, (scene.black, scene.white), 1.13, _NOW, "this frame, and the next" if held else "this frame")
    if not held:
        _draw_window(axes, (scene.black + moved, scene.white + moved), 1.01, _NEXT, "decided")
    axes.set_yticks([])
    axes.tick_params(labelbottom=False, bottom=False)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("dark          light of the scene          bright")


def _draw_window(axes: Axes, window: tuple[float, float], height: float, colour: str, words: str) -> None:
    """A bar above the histogram, from black to white."""
    place = axes.get_xaxis_transform()
    axes.plot(window, (height, height), "|-", color=colour, lw=2.5, ms=9, mew=2.5, transform=place, clip_on=False)
    middle = sum(window) / 2
    axes.text(middle, height + 0.015, words, transform=place, ha="center", va="bottom", color=colour, fontsize=11)


def _draw_promise(axes: Axes, moment: Moment) -> None:
    """What frames are worth by themselves, and the value of plans by their first exposure, which decides."""
    grounds, middle = moment.grounds, _middle(moment)
    places = middle - np.array(grounds.levels)
    alone = axes.twinx()
    axes.fill_between([], [], color=_WORTH, label="worth of a frame by itself, 0 to 1")
    alone.fill_between(places, grounds.worth, color=_WORTH, lw=0)
    alone.set_ylim(0, 1.05)
    alone.set_yticks([])
    axes.set_zorder(alone.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.plot(places, grounds.value, color="black", lw=1.8, label="worth of the plan that begins with it: decides")
    for level, colour in ((grounds.level, _NOW), (moment.decided_level, _NEXT)):
        axes.axvline(middle - level, color=colour, lw=1.4, ls=":")
        axes.plot(middle - level, np.interp(level, grounds.levels, grounds.value), "o", color=colour, ms=9)
    axes.set_xlabel("long          exposure level, stops          short")


MOST_MOMENTS = 8
"""In one picture."""

_STRIP = 4
_OTHER_STOPS = 0.25
"""Exposures, and changes of them, that differ by less count as the same."""


class BeliefStrip:
    """Watches a replay (see `report_replay`) and keeps the moments to be drawn.

    Those are the decisions on some triggers. Without any it is the one that changes the exposure most, and then the
    first frames of each exposure that it led to, four moments in all. Raises ConfigurationError when no picture can be
    drawn; from `see` and `draw`, too.
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
        if decision is None or loop is None or replayed.step.inputs.override.unseen:
            return
        if not self._wants(pair.trigger, frame.setting.level, decision.level):
            return
        grounds = loop.grounds
        if grounds is None:
            policy_id = loop.setup.policy_id
            raise ConfigurationError(f"policy {policy_id} has no belief to show: replay with --policy belief")
        scene = grounds.scenes.get(pair.reference_camera)
        if scene is None:  # nothing is known of this camera
            return
        seconds = (frame.host_time_ns - self._start_ns) * 1e-9
        words = f"{seconds:.2f} s, trigger {pair.trigger}: {frame.setting}\n{decision.reason}"
        picture = frame.grey8(loop.setup.responses[pair.reference_camera].saturation)
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
