"""What is mutated: the folders, and changes by name that must be among them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import islice, zip_longest
from pathlib import Path

from tests.mutation.operators import Change, changes

FOLDERS = {
    "control": "autoexpose_daemon/control",
    "drivers": "drivers",
    "imaging": "imaging",
    "calibration": "calibration",
    "evaluation": "evaluation",
}
"""By package. Of `evaluation` only what is listed by name."""

SAMPLED = ("control", "drivers", "calibration", "imaging")
"""Each gives as much of the sample."""

LEFT_OUT = {
    "calibration/report/": "the looks of a page and its plots are for eyes to judge",
    "drivers/aravis/": "meets cameras in real time only, where a kill may be a slow machine's",
}

LISTED = (
    # The feedback compares with the oldest decision that agrees.
    ("autoexpose_daemon/control/policy.py", "in reversed(self.past) if", "in self.past if"),
    # The best sample is promised instead of the polynomial's maximum.
    ("autoexpose_daemon/control/policies/published/begin2022.py", "beyond), best.value)", "beyond), metrics.max())"),
    # The arena judges the setting just decided instead of the one that the frame was taken with.
    ("evaluation/arena/race.py", "judge.judge(taken)", "judge.judge(series.delayed.decisions[-1].setting)"),
    # A delay that is a frame short.
    ("evaluation/stage/camera.py", "] * delay_frames", "] * (delay_frames - 1)"),
    # The true pose a frame late.
    ("evaluation/odometry/tracking.py", "stage.start_s(stage.frame) +", "stage.start_s(stage.frame + 1) +"),
    # Odometry without its gamma.
    ("evaluation/odometry/stereo.py", "cv2.LUT(cv2.medianBlur(image, 3), _CONTRAST)", "cv2.medianBlur(image, 3)"),
)
"""Mutants that once went unnoticed: file, what stands there once, what is put instead."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A file with one change; `number` tells those apart that would have the same name."""

    package: str
    path: str
    text: str
    change: Change
    number: int = 0

    @property
    def line(self) -> str:
        """The first line that is changed, as it was."""
        return self.text.splitlines()[self.change.line - 1].strip()

    @property
    def name(self) -> str:
        """What it is, whatever line it has moved to."""
        again = f" ({self.number + 1})" if self.number else ""
        return f"{self.path}: {self.line}: {self.change.before} -> {self.change.after}{again}"

    @property
    def mutated(self) -> str:
        """The file as mutated."""
        return self.change.apply(self.text)


def sources(root: Path) -> dict[str, str]:
    """All files of our packages, text by path."""
    files = (file for folder in FOLDERS.values() for file in sorted((root / folder).rglob("*.py")))
    return {file.relative_to(root).as_posix(): file.read_text() for file in files}


def listed(texts: dict[str, str]) -> list[Mutant]:
    """The mutants of `LISTED`."""
    return [_listed(texts[path], path, before, after) for path, before, after in LISTED]


def generated(texts: dict[str, str]) -> Iterator[Mutant]:
    """Every mutant that the operators make of what is sampled."""
    seen: Counter[str] = Counter()
    for path, text in texts.items():
        package = package_of(path)
        if package not in SAMPLED or path.startswith(tuple(LEFT_OUT)):
            continue
        for change in changes(text):
            mutant = Mutant(package, path, text, change)
            name = mutant.name
            yield replace(mutant, number=seen[name])
            seen[name] += 1


def sample(texts: dict[str, str], count: int, seed: int) -> list[Mutant]:
    """All that is listed, and as many others as make up `count`, equally many of each package.

    Which ones hangs on their names only: a change elsewhere in the code leaves most of the sample as it was.
    """
    chosen = listed(texts)
    names = {mutant.name for mutant in chosen}
    others = sorted(generated(texts), key=lambda mutant: sha256(f"{seed} {mutant.name}".encode()).digest())
    others = [mutant for mutant in others if mutant.name not in names]
    queues = [[mutant for mutant in others if mutant.package == package] for package in SAMPLED]
    in_turn = (mutant for turn in zip_longest(*queues) for mutant in turn if mutant is not None)
    return chosen + list(islice(in_turn, max(count - len(chosen), 0)))


def package_of(path: str) -> str:
    """The package of a file."""
    return next(name for name, folder in FOLDERS.items() if path.startswith(f"{folder}/"))


def _listed(text: str, path: str, before: str, after: str) -> Mutant:
    if text.count(before) != 1:
        raise ValueError(f"{path} has {before!r} {text.count(before)} times, not once: bring tests/mutation up to date")
    start = len(text[: text.index(before)].encode())
    line = text[: text.index(before)].count("\n") + 1
    return Mutant(package_of(path), path, text, Change(line, start, start + len(before.encode()), before, after))
