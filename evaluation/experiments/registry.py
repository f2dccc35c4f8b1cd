"""All experiments, in the order of the report."""

from __future__ import annotations

from evaluation.experiments.experiment import Experiment

EXPERIMENTS: tuple[Experiment, ...] = ()
"""In the order of the papers."""
