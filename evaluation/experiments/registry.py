"""All experiments, in the order of the report."""

from __future__ import annotations

from evaluation.experiments import fig7, fig12
from evaluation.experiments.experiment import Experiment

EXPERIMENTS: tuple[Experiment, ...] = (fig7.EXPERIMENT, fig12.EXPERIMENT)
"""In the order of the papers."""
