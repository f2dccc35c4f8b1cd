"""All experiments, in the order of the report."""

from __future__ import annotations

from evaluation.experiments.drives import fig7, fig12, fig13_orb_slam3
from evaluation.experiments.experiment import Experiment
from evaluation.experiments.navigation.navigation import EXPERIMENT as NAVIGATION
from evaluation.experiments.navigation.second_lap import EXPERIMENT as SECOND_LAP
from evaluation.experiments.prediction import fig1, fig3, fig10, fig11
from evaluation.experiments.rejudge.ranking import EXPERIMENT as REJUDGE
from evaluation.experiments.steering.steering import EXPERIMENT as STEERING
from evaluation.experiments.teach.teach_repeat import EXPERIMENT as TEACH
from evaluation.experiments.worth import worth

EXPERIMENTS: tuple[Experiment, ...] = (
    fig1.EXPERIMENT,
    fig3.EXPERIMENT,
    fig7.EXPERIMENT,
    fig10.EXPERIMENT,
    fig11.EXPERIMENT,
    fig12.EXPERIMENT,
    fig13_orb_slam3.EXPERIMENT,
    TEACH,
    NAVIGATION,
    SECOND_LAP,
    STEERING,
    REJUDGE,
    worth.EXPERIMENT,
    worth.TUNING,
)
"""In the order of the papers, then our own."""
