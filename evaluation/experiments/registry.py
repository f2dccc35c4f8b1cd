"""All experiments, in the order of the report."""

from __future__ import annotations

from evaluation.experiments.drives import fig7, fig12, fig13_orb_slam3
from evaluation.experiments.experiment import Experiment
from evaluation.experiments.navigation import navigation, second_lap
from evaluation.experiments.prediction import fig1, fig3, fig10, fig11
from evaluation.experiments.rejudge import ranking
from evaluation.experiments.steering import steering
from evaluation.experiments.teach import teach_repeat
from evaluation.experiments.worth import worth

_PAPERS = (fig1, fig3, fig7, fig10, fig11, fig12, fig13_orb_slam3, teach_repeat, navigation)
_OURS = (second_lap, steering, ranking, worth)
EXPERIMENTS: tuple[Experiment, ...] = (*(module.EXPERIMENT for module in (*_PAPERS, *_OURS)), worth.TUNING)
