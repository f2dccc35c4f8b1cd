from __future__ import annotations

import random
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.latency import TrialFrame, WriteTrial, write_effect

PERIOD_NS = 16_000_000
OLD, NEW = 100.0, 50.0


def trial(latency: int, *, lead_ns: int = 2_000_000, took_ns: int = 500_000, told: int | None = None) -> WriteTrial:
    """Frames 10 to 20; the write comes in the exposure of frame 12 and shows `latency` frames later."""
    frames = tuple(
        TrialFrame(
            number,
            number * PERIOD_NS,
            NEW if number - 12 >= latency else OLD,
            None if told is None else number - 12 >= told,
        )
        for number in range(10, 21)
    )
    return WriteTrial(12 * PERIOD_NS + lead_ns, 12 * PERIOD_NS + lead_ns + took_ns, frames)


@pytest.mark.parametrize("latency", [1, 2, 3])
def test_a_steady_camera_has_one_latency(latency: int) -> None:
    effect = write_effect("exposure", [trial(latency)] * 20)
    assert effect.frames == {latency: 20}
    assert (effect.mode, effect.unclear, effect.findings) == (latency, 0, ())
    assert effect.lead_us == pytest.approx(2500.0)
    assert effect.delay_us == pytest.approx((latency * 16_000 - 18_500.0, latency * 16_000 - 2500.0))


@given(st.dictionaries(st.integers(1, 4), st.integers(1, 40), min_size=1), st.integers(0, 2**32 - 1))
def test_the_histogram_counts_every_write(counts: dict[int, int], seed: int) -> None:
    trials = [trial(latency) for latency, count in counts.items() for _ in range(count)]
    random.Random(seed).shuffle(trials)
    effect = write_effect("gain", trials)
    assert effect.frames == dict(sorted(counts.items()))
    assert counts[effect.mode or 0] == max(counts.values())
    reasons = {finding.reason for finding in effect.findings}
    assert ("too_few_writes" in reasons) == (len(trials) < 5)
    assert ("irregular" in reasons) == (len(trials) >= 5 and max(counts.values()) < 0.95 * len(trials))


def test_an_irregular_camera_is_clear_with_its_histogram() -> None:
    (finding,) = write_effect("gain", [trial(1)] * 15 + [trial(2)] * 5).findings
    assert (finding.severity, finding.reason) == ("warned", "irregular")
    assert "(15 times 1, 5 times 2)" in finding.text


def without(spoilt: WriteTrial, frame_id: int) -> WriteTrial:
    return replace(spoilt, frames=tuple(frame for frame in spoilt.frames if frame.frame_id != frame_id))


def torn(spoilt: WriteTrial) -> WriteTrial:
    """Time and gain did not change together: one frame lies between old and new."""
    frames = (replace(frame, grey=75.0) if frame.frame_id == 13 else frame for frame in spoilt.frames)
    return replace(spoilt, frames=tuple(frames))


@pytest.mark.parametrize(
    "unclear",
    [
        trial(2, lead_ns=15_800_000),
        trial(20),
        trial(0),
        without(trial(2), 13),
        without(trial(2), 14),
        torn(trial(1)),
        replace(trial(1), frames=trial(1).frames[:3]),
        replace(trial(1), frames=trial(1).frames[3:]),
        WriteTrial(0, 1, ()),
    ],
    ids=[
        "met by two exposures",
        "no effect",
        "before the write",
        "lost",
        "lost",
        "torn",
        "cut",
        "no before",
        "nothing",
    ],
)
def test_writes_that_are_unclear_are_counted_apart(unclear: WriteTrial) -> None:
    effect = write_effect("exposure", [trial(2)] * 10 + [unclear] * 3)
    assert (effect.frames, effect.unclear) == ({2: 10}, 3)
    assert [finding.reason for finding in effect.findings] == ["unclear"]


def test_nothing_told_is_refused() -> None:
    effect = write_effect("exposure", [trial(20)] * 10)
    assert (effect.mode, effect.delay_us) == (None, None)
    assert [(finding.severity, finding.reason) for finding in effect.findings] == [("refused", "too_few_writes")]


def test_frames_that_claim_a_setting_too_early_are_told() -> None:
    assert write_effect("exposure", [trial(2, told=2)] * 10).findings == ()
    (finding,) = write_effect("exposure", [trial(2, told=1)] * 10).findings
    assert finding.reason == "metadata_off"
    assert "claim a new exposure 1 frames after its write, but show it after 2" in finding.text


def test_a_write_whose_effect_goes_away_again_is_not_told() -> None:
    """A lamp flickered, or something else wrote."""
    gone = trial(2)
    blinking = replace(
        gone, frames=tuple(replace(frame, grey=OLD) if frame.frame_id == 16 else frame for frame in gone.frames)
    )
    assert write_effect("exposure", [trial(2)] * 10 + [blinking] * 3).unclear == 3
