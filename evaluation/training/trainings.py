"""How each learned policy is trained."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files

import cv2

from autoexpose_daemon.control.policies import learned
from evaluation.training.berthold2013 import TrainingOfBerthold
from evaluation.training.tomasi2021 import TrainingOfTomasi
from evaluation.training.training import Training
from evaluation.training.zhang2024 import TrainingOfZhang

_TRAININGS: dict[str, Callable[[], Training]] = {
    "berthold2013": TrainingOfBerthold,
    "tomasi2021": TrainingOfTomasi,
    "zhang2024": TrainingOfZhang,
}


def training_of(policy_id: str) -> Training:
    """The training that made a policy's weights; OpenCV is told to use one core, as numpy does."""
    cv2.setNumThreads(1)
    return _TRAININGS[policy_id]()


def committed_weights(policy_id: str) -> bytes:
    """The weights that a policy has; none where there is no file."""
    file = files(learned).joinpath(f"{policy_id}.npz")
    return file.read_bytes() if file.is_file() else b""
