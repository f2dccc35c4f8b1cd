"""All experiments, in the order of the report."""

from __future__ import annotations

from evaluation.experiments import rejudge, steering
from evaluation.experiments.drives import fig7, fig12
from evaluation.experiments.experiment import Experiment
from evaluation.experiments.navigation import navigation, second_lap
from evaluation.experiments.prediction import fig1, fig3, fig10, fig11
from evaluation.experiments.teach import teach_repeat
from evaluation.experiments.worth import worth

_FIGURES = (fig1, fig3, fig7, fig10, fig11, fig12)
_OTHERS = (teach_repeat, navigation, second_lap, steering, rejudge, worth)
EXPERIMENTS: tuple[Experiment, ...] = (
    *(module.EXPERIMENT for module in _FIGURES),
    fig12.WITH_ORB_SLAM3,
    *(module.EXPERIMENT for module in _OTHERS),
    worth.TUNING,
)
