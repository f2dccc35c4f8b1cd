"""All experiments, in the order of the report."""

from __future__ import annotations

from evaluation.experiments.experiment import Experiment
from evaluation.experiments.teach.experiment import EXPERIMENT as TEACH

EXPERIMENTS: tuple[Experiment, ...] = (TEACH,)
"""In the order of the papers."""
