"""Trains `tomasi2021`: shown the level of most matches, in episodes that it drives through more and more by itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from autoexpose_daemon.control.policies.learned.policies import Sight, Tomasi2021
from evaluation.arrays import Floats, Floats32, Greys
from evaluation.training.episode import FAR_STOPS, Episode, TrainingPicture, tuning_pictures
from evaluation.training.training import Arrays, Batch, TrainedNet, net_arrays
from imaging.exposure import ExposureSetting

# Of the frames that features are looked for in: half of what control sees, since time grows with their size.
ROWS, COLUMNS = 144, 192
FEATURES = 250
# Of a descriptor, and the margin without features, pixels: in frames of this size, less would be left of OpenCV's.
PATCH = 21
NEAR_PX = 2.0  # Matches within this distance of the true motion count, as in `worth`
LOWE_RATIO = 0.8
STEP_STOPS = 1.0  # Between levels tried
LIT, FULL = 0.02, 0.97  # Levels whose frame has a mean signal outside of these show too little to be tried
GOOD = 0.9  # The answer is the mean of the levels with at least this share of the most matches, weighted by them
FEWEST = 8  # With fewer matches at best there is no answer
_ORB = cv2.ORB.create(FEATURES, edgeThreshold=PATCH, patchSize=PATCH, fastThreshold=15)
Image = Greys


def best_level(episode: Episode, frame: int) -> float | None:
    """The level (stops) at which a frame and the next share the most features; None where there are hardly any."""
    here, there = (_radiance(episode, number) for number in (frame, frame + 1))
    shift = np.array([(episode.left[frame] - episode.left[frame + 1]) / _shrunk_by(episode.picture), 0.0])
    limits = episode.limits
    levels = np.arange(limits.darkest.level, limits.brightest.level + STEP_STOPS / 2, STEP_STOPS)
    counts = np.zeros(len(levels))
    for place, level in enumerate(levels.tolist()):
        setting = episode.setting(level)
        first = episode.expose(here, setting, frame)
        if LIT < float(first.mean()) / 255.0 < FULL:
            counts[place] = _matches(first, episode.expose(there, setting, frame + 1), shift)
    smooth = np.convolve(counts, (0.25, 0.5, 0.25), "same")
    if smooth.max() < FEWEST:
        return None
    weights = np.where(smooth >= GOOD * smooth.max(), smooth, 0.0)
    return float(levels @ weights / weights.sum())


def _shrunk_by(picture: TrainingPicture) -> float:
    return picture.stride * 88 / COLUMNS


def _radiance(episode: Episode, frame: int) -> Floats32:
    """Of a whole view, with all its detail, shape (ROWS, COLUMNS)."""
    rows, columns = episode.whole_size
    left = int(episode.left[frame])
    whole = episode.picture.light[episode.top : episode.top + rows, left : left + columns]
    return np.asarray(cv2.resize(whole, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA), np.float32)


def _matches(first: Image, second: Image, shift: Floats) -> int:
    """Clear matches between two frames that agree with the true shift of the picture, in pixels."""
    (here, queries), (there, candidates) = (_ORB.detectAndCompute(each, None) for each in (first, second))
    if len(here) < 2 or len(there) < 2:
        return 0
    distances, nearest = cv2.batchDistance(queries, candidates, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    clear = np.flatnonzero(distances[:, 0] < LOWE_RATIO * distances[:, 1])
    moved = np.asarray(cv2.KeyPoint.convert(here), np.float64)[clear] + shift
    found = np.asarray(cv2.KeyPoint.convert(there), np.float64)[nearest[clear, 0]]
    return int((np.linalg.norm(found - moved, axis=1) <= NEAR_PX).sum())


INPUTS, UNITS = 130, 64
FRAMES = 64  # Of an episode
LABEL_EVERY = 9  # Frames: finding a label takes as long as 200 frames
VARIANTS = 7  # Besides the frames taken, the same moments seen at other exposures: a label holds for any of them
BATCH, RATE, LAST_RATE = 256, 1e-3, 1e-4
DECAY = 1e-4  # Share of the weights that each step takes away: labels are noisy
LARGEST_ERROR_STOPS = 1.0  # Larger errors pull no harder


@dataclass(frozen=True)
class TrainingOfTomasi:
    """`Training` of `tomasi2021`."""

    rounds: int = 60  # each of `episodes` episodes, then `updates` of the net with all that was labelled so far
    episodes: int = 16
    updates: int = 250
    polish: int = 5000  # updates with falling steps at the end
    pictures: int = 8  # seeds of pictures
    policy_id: str = "tomasi2021"

    @cached_property
    def _pictures(self) -> list[TrainingPicture]:
        return tuning_pictures(self.pictures)

    def begin(self, rng: np.random.Generator) -> Arrays:
        """A new net, and nothing labelled."""
        state: Arrays = {"inputs": np.zeros((0, INPUTS), np.float32), "wanted": np.zeros((0, 1), np.float32)}
        TrainedNet.begin(state, "net", (INPUTS, UNITS, UNITS, 1), rng)
        return state

    def proceed(self, state: Arrays, number: int, rng: np.random.Generator) -> None:
        """Label what the net, once it has learnt something, leads to; learn from all labels."""
        net = TrainedNet(state, "net")
        for _ in range(self.episodes):
            self._label(state, net if number else None, rng)
        for _ in range(self.updates):
            _update(state, net, RATE, rng)
        if number == self.rounds - 1:
            for step in range(self.polish):
                _update(state, net, RATE + (LAST_RATE - RATE) * step / self.polish, rng)

    def finish(self, state: Arrays, seed: int) -> Arrays:
        """The net as it is."""
        return net_arrays(TrainedNet(state, "net").layers, state["inputs"][::4], seed)

    def _label(self, state: Arrays, net: TrainedNet | None, rng: np.random.Generator) -> None:
        episode = Episode(self._pictures, rng, FRAMES)
        settings = _driven(episode, net, rng)
        inputs: list[Batch] = []
        wanted: list[float] = []
        for frame in range(Tomasi2021.FRAMES - 1, FRAMES - episode.delay_frames - 1, LABEL_EVERY):
            level = best_level(episode, frame + episode.delay_frames)
            if level is None:
                continue
            for taken in _variants(settings[frame - Tomasi2021.FRAMES + 1 : frame + 1], episode, rng):
                inputs.append(_inputs(episode, frame, taken))
                wanted.append(level - taken[-1].level)
        if inputs:
            state["inputs"] = np.concatenate([state["inputs"], np.array(inputs, np.float32)])
            state["wanted"] = np.concatenate([state["wanted"], np.array(wanted, np.float32)[:, None]])


def _driven(episode: Episode, net: TrainedNet | None, rng: np.random.Generator) -> list[ExposureSetting]:
    """The settings of all frames: as the net decides, now and then disturbed; at random while there is no net."""
    settings = [episode.start] * episode.delay_frames
    sights: list[Sight] = []
    while len(settings) < episode.frames:
        frame = len(sights)
        if net is None:
            settings.append(episode.start if rng.random() < 0.2 else settings[-1])
            continue
        look = episode.look(frame, settings[frame])
        sights.append(Sight("left", settings[frame].level, Tomasi2021.features(look)))
        last = sights[-Tomasi2021.FRAMES :]
        seen = [last[0]] * (Tomasi2021.FRAMES - len(last)) + last
        inputs = Tomasi2021.inputs(seen, settings[frame].gain_db).astype(np.float32)
        change = float(net.forward(inputs[None])[0, 0])
        if rng.random() < 0.03:
            change += float(rng.normal(0.0, 2.0))
        settings.append(episode.setting(settings[frame].level + change))
    return settings[: episode.frames]


def _variants(taken: list[ExposureSetting], episode: Episode, rng: np.random.Generator) -> list[list[ExposureSetting]]:
    """The settings of successive frames, and others: all shifted alike, or each a little differently."""
    variants = [taken]
    for _ in range(VARIANTS):
        shift = float(rng.uniform(-FAR_STOPS, FAR_STOPS)) * float(rng.random())
        spread = float(rng.choice((0.0, 0.2, 1.5)))
        variants.append(
            [episode.setting(setting.level + shift + spread * float(rng.standard_normal())) for setting in taken]
        )
    return variants


def _inputs(episode: Episode, frame: int, settings: list[ExposureSetting]) -> Batch:
    """Inputs of the net at a frame, if it and those before it were taken with these settings."""
    first = frame - len(settings) + 1
    sights = [
        Sight("left", setting.level, Tomasi2021.features(episode.look(first + place, setting)))
        for place, setting in enumerate(settings)
    ]
    return Tomasi2021.inputs(sights, settings[-1].gain_db).astype(np.float32)


def _update(state: Arrays, net: TrainedNet, rate: float, rng: np.random.Generator) -> None:
    places = rng.integers(len(state["inputs"]), size=BATCH)
    errors = net.forward(state["inputs"][places]) - state["wanted"][places]
    slopes = np.clip(errors, -LARGEST_ERROR_STOPS, LARGEST_ERROR_STOPS) / np.float32(BATCH)
    gradients, _ = net.backward(slopes)
    net.descend(gradients, rate)
    for name in net.names:
        if ".matrix" in name:
            state[name] *= np.float32(1.0 - DECAY)
