"""A replay to look at: exposure, gain, reasons and belief over time, recorded and replayed beside each other."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision, SceneHistogram
from autoexpose_daemon.recording.replay import Replay, Replayed
from documents.files import check_writable
from imaging.errors import ConfigurationError
from imaging.frames import Frame, FrameSet

PICTURES = 8
WIDTH_PX = 320
BELIEF_S = 0.25
"""How often the belief is kept."""

_BIN_STOPS = 0.25
_LANE = 1000.0, 100.0
_MOST_POINTS = 1500


class ReplayLog:
    """Watches a replay (see `report_replay`) and writes what it has seen: JSON, a page, or both.

    Raises ConfigurationError when a file cannot be written.
    """

    def __init__(self, json_file: Path | None, page: Path | None) -> None:
        for file, option, suffix in ((json_file, "--json", ".json"), (page, "--html", ".html")):
            if file is not None:
                if file.suffix != suffix:  # so that no recording is ever replaced
                    raise ConfigurationError(f"{option} {file}: name a {suffix} file")
                check_writable(file)
        self._json_file, self._page = json_file, page
        self._steps: list[dict[str, Any]] = []
        self._start_ns: int | None = None
        self._policies = "?", "?"
        self._pictures: list[tuple[float, FrameSet, Replayed]] = []
        self._every = 1
        self._scenes: list[tuple[float, SceneHistogram]] = []

    def see(self, player: Replay, replayed: Replayed) -> None:
        """Keep a step."""
        step = replayed.step
        frame = step.pair.reference
        if self._start_ns is None:
            self._start_ns = frame.host_time_ns
        time_s = (frame.host_time_ns - self._start_ns) * 1e-9
        if player.setup is not None:
            recorded = player.setup.control.policy_id
            self._policies = recorded, recorded if player.loop is None else player.loop.setup.policy_id
        self._steps.append(
            {
                "time_s": round(time_s, 6),
                "trigger": step.pair.trigger,
                "cameras": {camera: _setting(each) for camera, each in step.pair.frames.items()},
                "recorded": _decided(step.decision),
                "replayed": None if replayed.decision is None else _decided(replayed.decision),
                "same": replayed.same,
                "dropped": replayed.dropped,
                "requests": list(step.requests),
            }
        )
        if self._page is not None:
            self._keep_for_page(time_s, player, replayed)

    def write(self) -> list[str]:
        """Write the files; the lines to tell."""
        recorded, replayed = self._policies
        document = {"recorded_policy": recorded, "replayed_policy": replayed, "steps": self._steps}
        said = []
        if self._json_file is not None:
            self._json_file.write_text(json.dumps(document) + "\n", encoding="utf-8")
            said.append(f"{len(self._steps)} steps: {self._json_file}")
        if self._page is not None:
            self._page.write_text(self._html(), encoding="utf-8")
            said.append(f"page: {self._page}")
        return said

    def _keep_for_page(self, time_s: float, player: Replay, replayed: Replayed) -> None:
        """Pictures at even distances, ever farther apart; and the belief, at most so often."""
        if len(self._steps) % self._every == 1 or self._every == 1:
            self._pictures.append((time_s, _small(replayed.step.pair), replayed))
            if len(self._pictures) == 2 * PICTURES:
                self._pictures = self._pictures[::2]
                self._every *= 2
        if player.loop is None or (self._scenes and time_s < self._scenes[-1][0] + BELIEF_S):
            return
        grounds = player.loop.grounds
        scene = None if grounds is None else grounds.scenes.get(replayed.step.pair.reference_camera)
        if scene is not None:
            self._scenes.append((time_s, scene))

    def _html(self) -> str:
        template = Template(Path(__file__).with_name("replay.html").read_text(encoding="utf-8"))
        recorded, replayed = self._policies
        end_s = self._steps[-1]["time_s"] if self._steps else 0.0
        return template.substitute(
            recorded=html.escape(recorded), replayed=html.escape(replayed), steps=len(self._steps),
            seconds=f"{end_s:.1f}", lanes="\n".join(self._lanes(max(end_s, 1e-3))), reasons="\n".join(self._reasons()),
            pictures="\n".join(self._shown()), data=json.dumps(self._for_cursor()).replace("</", "<\\/"),
            end_s=f"{end_s:.6f}",
        )  # fmt: skip

    def _lanes(self, end_s: float) -> list[str]:
        if not self._steps:
            return []
        times = np.array([step["time_s"] for step in self._steps]) / end_s

        def values(of: Callable[[Mapping[str, Any]], float | None]) -> NDArray[np.float64]:
            return np.array([np.nan if (value := of(step)) is None else value for step in self._steps], np.float64)

        def both(name: str) -> list[tuple[str, NDArray[np.float64]]]:
            return [
                ("recorded", values(lambda step: step["recorded"][name])),
                ("replayed", values(lambda step: None if step["replayed"] is None else step["replayed"][name])),
            ]

        shares = [
            ("white", values(lambda step: 100 * step["recorded"]["saturated_share"])),
            ("black", values(lambda step: 100 * step["recorded"]["black_share"])),
        ]
        times_ms = [(name, np.log10(each / 1000.0)) for name, each in both("exposure_time_us")]
        lanes = [
            _lane("exposure level, stops", times, both("level")),
            _lane("exposure time, ms", times, times_ms, ticks=_decades),
            _lane("gain, dB", times, both("gain_db")),
            _lane("white (red) and black in the picture that is decided on, %", times, shares),
        ]
        return lanes if len(self._scenes) < 2 else [*lanes, self._belief(end_s)]

    def _belief(self, end_s: float) -> str:
        """The histogram of the scene over time, with black and white of the newest frame."""
        scenes = [scene for _, scene in self._scenes]
        low = min(min(scene.black, _visible(scene)[0]) for scene in scenes) - 1.0
        high = max(max(scene.white, _visible(scene)[1]) for scene in scenes) + 1.0
        stops = np.arange(low, high, _BIN_STOPS)
        columns = [_column(scene, stops) for scene in scenes]
        image = np.stack(columns, axis=1)[::-1]
        grey = np.asarray(255 - 200 * np.sqrt(np.minimum(image / max(float(image.max()), 1e-9), 1.0)), np.uint8)
        encoded = base64.b64encode(cv2.imencode(".png", grey)[1].tobytes()).decode()
        width, height = _LANE
        at = np.array([time_s for time_s, _ in self._scenes]) / end_s
        begin, span = at[0] * width, (at[-1] - at[0]) * width
        bounds = [
            _line("bound", at, (high - np.array([getattr(scene, name) for scene in scenes])) / (high - low) * height)
            for name in ("black", "white")
        ]
        return (
            f"<figure><figcaption>light of the scene that is believed in, stops: {low:.0f} to {high:.0f}; between the "
            "lines the newest frame shows it</figcaption>"
            f'<svg class="lane" viewBox="0 0 {width:g} {height:g}" preserveAspectRatio="none">'
            f'<image href="data:image/png;base64,{encoded}" x="{begin:.1f}" width="{span:.1f}" height="{height:g}" '
            f'preserveAspectRatio="none"/>{"".join(bounds)}</svg></figure>'
        )

    def _reasons(self) -> list[str]:
        """A row whenever either gives another reason; numbers in them do not count."""
        rows: list[str] = []
        former: tuple[str, ...] = ()
        for step in self._steps:
            said = step["recorded"]["reason"], "-" if step["replayed"] is None else step["replayed"]["reason"]
            kinds = tuple("".join(letter for letter in text if not letter.isdigit()) for text in said)
            if kinds != former:
                former = kinds
                cells = "".join(f"<td>{html.escape(text)}</td>" for text in said)
                rows.append(f"<tr><td>{step['time_s']:.2f}</td><td>{step['trigger']}</td>{cells}</tr>")
        return rows[:500]

    def _shown(self) -> list[str]:
        return [_strip(time_s, pair, replayed) for time_s, pair, replayed in self._pictures]

    def _for_cursor(self) -> list[list[Any]]:
        every = max(len(self._steps) // _MOST_POINTS, 1)
        return [
            [
                step["time_s"], step["trigger"],
                *(
                    None if one is None else [round(one["exposure_time_us"]), round(one["gain_db"], 1), one["reason"]]
                    for one in (step["recorded"], step["replayed"])
                ),
            ]
            for step in self._steps[::every]
        ]  # fmt: skip


def _setting(frame: Frame) -> dict[str, float]:
    return {"exposure_time_us": frame.setting.exposure_time_us, "gain_db": frame.setting.gain_db}


def _decided(decision: Decision) -> dict[str, Any]:
    return {
        "exposure_time_us": decision.setting.exposure_time_us,
        "gain_db": decision.setting.gain_db,
        "level": decision.level,
        "reason": decision.reason,
        "saturated_share": decision.saturated_share,
        "black_share": decision.black_share,
    }


def _small(pair: FrameSet) -> FrameSet:
    """With pictures that may be kept: grey, and no larger than they are shown."""

    def small(frame: Frame) -> Frame:
        grey = frame.grey8()
        height = max(round(grey.shape[0] * WIDTH_PX / grey.shape[1]), 1)
        pixels = np.asarray(cv2.resize(grey, (WIDTH_PX, height), interpolation=cv2.INTER_AREA), np.uint8)
        return replace(frame, pixels=pixels, layout="grey")

    return FrameSet(pair.trigger, {camera: small(frame) for camera, frame in pair.frames.items()})


def _strip(time_s: float, pair: FrameSet, replayed: Replayed) -> str:
    figures = []
    for camera, frame in pair.frames.items():
        jpeg = base64.b64encode(cv2.imencode(".jpg", frame.pixels)[1].tobytes()).decode()
        figures.append(
            f'<figure><img src="data:image/jpeg;base64,{jpeg}" alt="{html.escape(camera)}">'
            f"<figcaption>{html.escape(camera)}: {frame.setting}</figcaption></figure>"
        )
    said = [f"recorded: {replayed.step.decision.setting}, {replayed.step.decision.reason}"]
    if replayed.decision is not None:
        said.append(f"replayed: {replayed.decision.setting}, {replayed.decision.reason}")
    words = "<br>".join(html.escape(text) for text in said)
    return f"<h3>{time_s:.2f} s, trigger {pair.trigger}</h3><div class=pair>{''.join(figures)}</div><p>{words}</p>"


def _visible(scene: SceneHistogram) -> tuple[float, float]:
    """Radiance between which bins are high enough to be seen."""
    heights = np.array(scene.known) + np.array(scene.guessed)
    high = np.flatnonzero(heights > 0.05 * heights.max())
    return scene.start + scene.bin_stops * float(high[0]), scene.start + scene.bin_stops * float(high[-1] + 1)


def _column(scene: SceneHistogram, stops: NDArray[np.float64]) -> NDArray[np.float64]:
    centres = scene.start + scene.bin_stops * (np.arange(len(scene.known)) + 0.5)
    return np.asarray(np.interp(stops, centres, np.array(scene.known) + np.array(scene.guessed), 0.0, 0.0))


Ticks = Callable[[float, float], Sequence[tuple[float, str]]]


def _even(low: float, high: float) -> Sequence[tuple[float, str]]:
    step = next(each for each in (0.5, 1, 2, 5, 10, 20, 50, 100) if (high - low) / each <= 5 or each == 100)
    return [(float(tick), f"{tick + 0.0:g}") for tick in np.arange(np.ceil(low / step) * step, high + 1e-9, step)]


def _decades(low: float, high: float) -> Sequence[tuple[float, str]]:
    ticks = [(float(np.log10(each)), f"{each:g}") for each in (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000)]
    return [(tick, words) for tick, words in ticks if low <= tick <= high]


def _lane(
    title: str, times: NDArray[np.float64], curves: Sequence[tuple[str, NDArray[np.float64]]], ticks: Ticks = _even
) -> str:
    known = np.concatenate([values[np.isfinite(values)] for _, values in curves])
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    margin = max((high - low) * 0.06, 0.25)
    low, high = low - margin, high + margin
    width, height = _LANE
    marks = [((high - tick) / (high - low), text) for tick, text in ticks(low, high)]
    lines = [f'<path class="grid" d="M0 {share * height:.1f} H{width:g}"/>' for share, _ in marks]
    words = "".join(f'<span style="top:{100 * share:.1f}%">{text}</span>' for share, text in marks)
    drawn = "".join(_line(name, times, (high - values) / (high - low) * height) for name, values in curves)
    return (
        f"<figure><figcaption>{title}</figcaption><div class=axis>{words}"
        f'<svg class="lane" viewBox="0 0 {width:g} {height:g}" preserveAspectRatio="none">{"".join(lines)}{drawn}</svg>'
        "</div></figure>"
    )


def _line(name: str, times: NDArray[np.float64], heights: NDArray[np.float64]) -> str:
    """A path of steps; it is broken where nothing is known. A value in a stretch of many is its first."""
    every = max(len(times) // _MOST_POINTS, 1)
    path, down = [], False
    for x, y in zip(times[::every] * _LANE[0], heights[::every], strict=True):
        if not np.isfinite(y):
            down = False
            continue
        path.append(f"{'H' if down else 'M'}{x:.1f}{' V' if down else ' '}{y:.1f}")
        down = True
    return f'<path class="{name}" d="{" ".join(path)}"/>'
