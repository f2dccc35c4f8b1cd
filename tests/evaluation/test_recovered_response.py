from __future__ import annotations

from tests.evaluation.recovered import metric_ratios


def test_the_default_policy_does_as_well_with_a_recovered_response() -> None:
    ratios = metric_ratios("gamma", "step_up", "leaves", 2000)

    assert ratios["recovered"] > 0.99 * ratios["true"]
    assert ratios["linear"] < 0.99 * ratios["true"]  # so the response does matter here
