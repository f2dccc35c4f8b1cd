"""Every trigger becomes a pair or one loss: the account against a wire that knows what really happened."""

from __future__ import annotations

import weakref
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import IncompleteFrame
from drivers.triggers.account import TriggerAccount
from drivers.triggers.outcomes import LossReason
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet

PERIOD_NS = 16_666_667
OPENED_NS = 5_000_000_000
PHASE_NS = OPENED_NS + 7_000_000


def frame(frame_id: int, time_ns: int) -> Frame:
    return Frame(np.zeros((2, 2), np.uint8), 8, frame_id, time_ns, time_ns, time_ns, ExposureSetting(1000.0, 0.0))


@dataclass
class FakeRig:
    """Plays triggers to an account; at each one, every camera follows the script."""

    cameras: tuple[CameraName, ...] = ("left", "right")
    period_ns: float = PERIOD_NS
    numbered_by: str = "time"
    trigger: int = 0
    frame_ids: Counter[CameraName] = field(default_factory=Counter)
    released: list[FrameSet] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.account = TriggerAccount(self.cameras, PERIOD_NS, OPENED_NS, self.numbered_by)  # type: ignore[arg-type]

    @property
    def time_ns(self) -> int:
        return round(PHASE_NS + self.trigger * self.period_ns)

    def pulse(self, **does: str) -> None:
        for camera in self.cameras:
            match does.get(camera, "frame"):
                case "frame":
                    self.frame_ids[camera] += 1
                    self.released += self.account.frame(camera, frame(self.frame_ids[camera], self.time_ns))
                case "missing":
                    self.frame_ids[camera] += 1
                case "incomplete":
                    self.frame_ids[camera] += 1
                    lost = IncompleteFrame(self.frame_ids[camera], None)
                    self.released += self.account.incomplete(camera, lost)
                case "stale":
                    self.frame_ids[camera] += 1
                    self.released += self.account.stale(camera, frame(self.frame_ids[camera], self.time_ns))
                case "goes":
                    self.frame_ids[camera] = 0
                    self.released += self.account.gone(camera)
                case "silent":
                    self.released += self.account.silent(camera)
                case "ignored" | "absent":
                    pass
        self.trigger += 1

    def pulses(self, count: int, **does: str) -> None:
        for _ in range(count):
            self.pulse(**does)

    def play(self, *steps: tuple[int, str, str]) -> FakeRig:
        """Steps of so many triggers, with what the left and the right camera do at each."""
        for count, left, right in steps:
            if "ready" in (left, right):  # from now on, or from so many triggers on
                for camera in self.cameras:
                    if {"left": left, "right": right}[camera] == "ready":
                        self.account.ready(camera, self.time_ns + count * PERIOD_NS)
            else:
                self.pulses(count, left=left, right=right)
        return self

    def close(self) -> dict[str, int]:
        self.trigger -= 1
        self.account.close(self.time_ns + PERIOD_NS // 3)
        return {str(reason): count for reason, count in self.account.tally.lost.items() if count}


def test_triggers_that_were_not_given_have_their_own_reason() -> None:
    """Frames of triggers before the pause may arrive after its end."""
    rig = FakeRig()
    rig.pulses(3)
    for count, camera in ((4, "left"), (40, "right"), (4, "right")):
        rig.account.not_given("left" if camera == "left" else "right", count)
        rig.pulse()
        rig.pulses(count, **{camera: "absent"})
    rig.pulses(3, left="missing")
    rig.pulses(3, right="ignored")
    rig.pulse()
    assert rig.close() == {"not_given": 48, "left_missing": 3, "trigger_ignored": 3}


def test_the_window_holds_exactly_the_triggers_accounted_for() -> None:
    rig = FakeRig()
    rig.pulses(10)
    rig.close()
    tally = rig.account.tally
    assert tally.window_start_ns is not None and tally.window_end_ns is not None
    inside = [n for n in range(-5, 20) if tally.window_start_ns <= PHASE_NS + n * PERIOD_NS < tally.window_end_ns]
    assert inside == list(range(10))


F, A, M, X, S, G = "frame", "absent", "missing", "ignored", "silent", "goes"
STOP = (100, X, X)


@pytest.mark.parametrize(
    ("steps", "lost", "pairs"),
    [
        # before the first pair, after the last, and no trigger at all
        (((4, A, A), (3, F, A), (5, F, F), (2, A, A)), {"startup": 7, "shutdown": 2}, 5),
        (((3, "ready", "ready"), (200, A, A), (5, F, F)), {"startup": 4}, 5),
        (((0, A, "ready"), (1000, F, A)), {"startup": 1, "trigger_ignored": 999}, 0),
        # a trigger that stops, and frames lost around that
        (((3, F, F), STOP, (3, F, F)), {}, 6),
        (((3, F, F), (1, S, S), (5000, X, X), (3, F, F)), {}, 6),
        (((3, F, F), (1, M, F), STOP, (1, M, F), (3, F, F)), {"left_missing": 2}, 6),
        (((3, F, F), (3, M, F), (5000, X, X), (3, F, F)), {"left_missing": 3}, 6),
        (((3, F, F), STOP, (3, M, F), (3, F, F)), {"left_missing": 3}, 6),
        (((3, F, F), (5000, X, X), (1, M, M), (3, F, F)), {"both_missing": 1}, 6),
        # while one camera is gone
        (((3, F, F), (1, G, F), (1000, A, X), (0, "ready", A), (1000, X, X), (3, F, F)), {"camera_gone": 1}, 6),
        (((3, F, F), (1, G, F), (1000, A, X), (1, A, F), (3, F, F)), {"camera_gone": 2}, 6),
        # at the end
        (((5, F, F), (1, S, S), (1000, X, X)), {}, 5),
        (((5, F, F), (1, G, F), (1, A, S), (1000, A, X)), {"camera_gone": 1}, 5),
        (((5, F, F), (1, F, F), (1, G, S), (1000, A, X)), {}, 6),
        (((5, F, F), (1, F, S), (9, F, A), (1, S, X), (1000, X, X)), {"right_missing": 10}, 5),
    ],
)
def test_what_no_pair_was_made_of_is_lost_for_one_reason(
    steps: tuple[tuple[int, str, str], ...], lost: dict[str, int], pairs: int
) -> None:
    for cameras in (("left", "right"), ("right", "left")):
        rig = FakeRig(cameras).play(*steps)  # type: ignore[arg-type]
        assert (rig.close(), rig.account.tally.pairs) == (lost, pairs)


@pytest.mark.parametrize(
    ("left", "right", "reason"),
    [
        (M, F, "left_missing"),
        (F, M, "right_missing"),
        (M, M, "both_missing"),
        ("incomplete", F, "incomplete"),
        (M, "incomplete", "incomplete"),
        (X, F, "trigger_ignored"),
        (X, X, "trigger_ignored"),
        (X, M, "trigger_ignored"),
        (F, "stale", "stale"),
    ],
)
def test_each_fate_has_its_reason(left: str, right: str, reason: str) -> None:
    rig = FakeRig().play((3, F, F), (2, left, right), (3, F, F))
    assert (rig.close(), rig.account.tally.pairs) == ({reason: 2}, 6)
    pairs = [pair for pair in rig.released if len(pair.frames) == 2]
    assert [pair.trigger for pair in pairs] == [0, 1, 2, 5, 6, 7]
    assert all(pair.frames["left"].host_time_ns == pair.frames["right"].host_time_ns for pair in pairs)


def test_triggers_that_were_not_given_before_the_first_frame_explain_no_later_loss() -> None:
    rig = FakeRig()
    rig.account.not_given("left", 3)
    rig.play((3, A, F), (3, F, F), (2, X, F), (1, F, F))
    assert rig.close() == {"startup": 3, "trigger_ignored": 2}


@pytest.mark.parametrize(("steps", "released"), [(((3, F, F), (1, F, S), (2000, F, A)), 1900), (((2000, F, A),), 2000)])
def test_a_camera_that_sends_nothing_takes_bounded_memory(
    steps: tuple[tuple[int, str, str], ...], released: int
) -> None:
    rig = FakeRig().play(*steps)
    assert len(rig.account._outcomes) < 700
    assert len(rig.released) >= released
    rig.close()
    assert rig.account.tally.triggers == rig.trigger + 1


@pytest.mark.parametrize(("event", "lost"), [(S, {}), (G, {"camera_gone": 10**9 + 1})])
def test_a_year_without_frames_is_over_at_once(event: str, lost: dict[str, int]) -> None:
    rig = FakeRig().play((3, F, F), (1, event, event))
    rig.trigger += 10**9
    assert (rig.play((3, F, F)).close(), rig.account.tally.pairs) == (lost, 6)


@pytest.mark.parametrize(("rate_error", "apart_ns"), [(0.0004, 0), (0.0, 100_000)])
def test_an_outage_is_counted_by_the_clock_as_it_runs(rate_error: float, apart_ns: int) -> None:
    """Of cameras that start apart by as much as a reading of their clocks may be off, too."""
    rig = FakeRig(period_ns=PERIOD_NS * (1 + rate_error))
    for trigger in range(600):
        for camera, later_ns in (("left", 0), ("right", apart_ns)):
            rig.account.frame(camera, frame(trigger + 1, rig.time_ns + later_ns))  # type: ignore[arg-type]
        rig.trigger += 1
    rig.play((1, G, G), (1200, A, A), (5, F, F))
    assert rig.close() == {"camera_gone": 1201}


def test_frames_at_a_multiple_of_the_rate_are_surplus_and_hide_no_loss() -> None:
    rig = FakeRig(period_ns=PERIOD_NS / 4).play((40, F, F))
    assert rig.account.tally.surplus_frames > 0
    assert rig.account.tally.triggers <= 12
    rig = FakeRig(period_ns=PERIOD_NS / 2).play((20, F, F), (1, M, F), (19, F, F))  # the next frame is surplus
    assert rig.close() == {"left_missing": 1}
    rig = FakeRig().play((3, F, F))
    rig.account.frame("left", frame(3, rig.time_ns - PERIOD_NS))  # it comes twice
    assert rig.play((1, M, F), (2, F, F)).close() == {"left_missing": 1}


def test_a_trigger_that_resumes_in_another_phase_is_followed_at_once() -> None:
    rig = FakeRig().play((10, F, F))
    rig.trigger += 50.5  # type: ignore[assignment]
    rig.play((10, F, F))
    assert (rig.account.tally.pairs, rig.account.tally.surplus_frames) == (20, 0)


def test_a_single_free_running_camera_is_counted_by_its_frame_ids() -> None:
    rig = FakeRig(cameras=("left",), period_ns=PERIOD_NS * 1.3, numbered_by="frame_id")
    rig.play((50, F, F), (3, M, F), (50, F, F))
    assert (rig.close()["left_missing"], rig.account.tally.pairs) == (3, 100)


def test_a_lost_camera_leaves_the_other_exposing() -> None:
    rig = FakeRig()
    rig.pulses(3)
    rig.pulses(2, left="absent")
    before = len(rig.released)
    rig.pulse(left="silent")
    rig.pulses(2, left="absent")
    assert [pair.trigger for pair in rig.released[before:]] == [3, 4, 5, 6, 7]
    rig.pulse(left="goes")
    rig.pulses(4, left="absent")
    rig.pulses(3)
    assert rig.close() == {"camera_gone": 10}
    assert rig.account.tally.pairs == 6


def test_without_any_frame_whole_periods_are_counted() -> None:
    account = TriggerAccount(("left", "right"), PERIOD_NS, OPENED_NS)
    account.gone("left")
    account.close(OPENED_NS + 10 * PERIOD_NS + 5)
    assert account.tally.triggers == 10
    assert account.tally.lost[LossReason.CAMERA_GONE] == 10


@pytest.mark.parametrize("rate_error", [0.003, 0.05, -0.05, 0.2])
def test_frames_at_another_rate_still_make_pairs(rate_error: float) -> None:
    rig = FakeRig(period_ns=PERIOD_NS * (1 + rate_error))
    rig.pulses(600)
    assert rig.account.tally.pairs >= 560
    assert sum(len(pair.frames) < 2 for pair in rig.released) <= 1


@pytest.mark.parametrize("lost", [None, "left", "both"])
def test_a_doubled_trigger_never_pairs_one_instant_with_another(lost: str | None) -> None:
    rig = FakeRig(period_ns=PERIOD_NS / 2)
    rig.pulses(20)
    if lost is not None:
        rig.pulse(**dict.fromkeys(("left", "right") if lost == "both" else (lost,), "missing"))
    rig.pulses(20)
    complete = [pair for pair in rig.released if len(pair.frames) == 2]
    assert len(complete) >= 19
    assert all(pair.frames["left"].frame_id == pair.frames["right"].frame_id for pair in complete)
    assert rig.account.tally.surplus_frames >= 38


def test_the_first_frames_are_not_paired_if_they_are_of_different_instants() -> None:
    rig = FakeRig(period_ns=0.4 * PERIOD_NS)
    rig.pulse(right="missing")
    rig.pulse(left="missing")
    assert rig.account.tally.pairs == 0
    assert rig.account.tally.surplus_frames == 1


def test_a_doubled_trigger_pairs_no_instants_of_a_camera_whose_frames_arrive_late() -> None:
    """A lost frame moves the grid while frames of the camera that lags behind are on their way."""
    account = TriggerAccount(("left", "right"), PERIOD_NS, OPENED_NS)
    pairs: list[FrameSet] = []
    for number in range(200):
        for camera, shown in (("right", number), ("left", number - 4)):
            if shown < 0 or (camera, shown % 50) in (("right", 20), ("left", 16)):
                continue
            pairs += account.frame(camera, frame(shown, PHASE_NS + shown * PERIOD_NS // 2))  # type: ignore[arg-type]
    complete = [pair for pair in pairs if len(pair.frames) == 2]
    assert len(complete) > 30
    assert all(pair.frames["left"].frame_id == pair.frames["right"].frame_id for pair in complete)


@pytest.mark.parametrize("periods", [100, 5000])
def test_cameras_that_wait_for_an_absent_trigger_lose_nothing(periods: int) -> None:
    account = TriggerAccount(("left", "right"), PERIOD_NS, OPENED_NS)
    account.gone("left")
    for camera in ("left", "right"):
        account.ready(camera, OPENED_NS + 20 * PERIOD_NS)  # type: ignore[arg-type]
    account.close(OPENED_NS + (20 + periods) * PERIOD_NS)
    assert account.tally.triggers == 0


@pytest.mark.parametrize(("newest", "goes_on_after"), [(3, 2), (20, 0)])
def test_a_free_run_goes_on_after_a_frame_id_that_comes_twice_or_a_counter_that_restarts(
    newest: int, goes_on_after: int
) -> None:
    rig = FakeRig(cameras=("left",), numbered_by="frame_id")
    rig.pulses(newest)
    rig.frame_ids["left"] = goes_on_after
    rig.pulses(10)
    assert rig.account.tally.pairs == newest + 9
    assert (rig.account.tally.surplus_frames, dict(rig.account.tally.lost)) == (1, {})


FATES = st.sampled_from(["frame", "frame", "frame", "missing", "ignored", "incomplete", "stale"])


@settings(max_examples=200, deadline=None)
@given(
    fates=st.lists(st.tuples(FATES, FATES), max_size=60),
    rate_error=st.floats(-2e-4, 2e-4),
    outage=st.tuples(st.integers(0, 200), st.booleans(), st.booleans()),
)
def test_whatever_happens_the_account_balances(
    fates: list[tuple[str, str]], rate_error: float, outage: tuple[int, bool, bool]
) -> None:
    rig = FakeRig(period_ns=PERIOD_NS * (1 + rate_error))
    rig.pulses(2)
    for left, right in fates:
        rig.pulse(left=left, right=right)
    length, left_goes, right_goes = outage
    rig.pulse(left="goes" if left_goes else "frame", right="goes" if right_goes else "frame")
    rig.pulses(length, left="absent" if left_goes else "frame", right="absent" if right_goes else "frame")
    rig.pulses(2)
    sent = rig.trigger
    rig.close()
    assert rig.account.tally.triggers == sent
    complete = [pair for pair in rig.released if len(pair.frames) == 2]
    alone = [pair.trigger for pair in rig.released if len(pair.frames) < 2]
    assert len(alone) == len(set(alone))
    assert len(complete) == rig.account.tally.pairs
    assert all(len({frame.host_time_ns for frame in pair.frames.values()}) == 1 for pair in complete)


def test_triggers_that_no_camera_had_time_to_show_are_lost_at_startup() -> None:
    """Cameras that were ready for a tenth of a second do not show whether there were triggers."""
    rig = FakeRig()
    for camera in rig.cameras:
        rig.account.ready(camera, OPENED_NS + 4 * PERIOD_NS)
    rig.account.close(OPENED_NS + 10 * PERIOD_NS + PERIOD_NS // 3)
    tally = rig.account.tally
    assert dict(tally.lost) == {LossReason.STARTUP: 10}
    assert tally.window_start_ns is not None and tally.window_end_ns is not None
    assert tally.window_start_ns == pytest.approx(OPENED_NS, abs=2)
    assert tally.window_end_ns - tally.window_start_ns == pytest.approx(10 * PERIOD_NS, abs=2)


def test_frames_handed_out_alone_are_not_kept_for_a_partner_that_never_comes() -> None:
    rig = FakeRig()
    rig.pulses(3)
    alive: list[weakref.ref[np.ndarray]] = []
    for _ in range(100):
        rig.pulse(right="silent")
        alive += [weakref.ref(pair.frames["left"].pixels) for pair in rig.released]
        rig.released.clear()
    assert len(alive) >= 100
    assert sum(pixels() is not None for pixels in alive) < 12


def test_no_frame_waits_for_a_camera_whose_frames_all_start_between_those_of_the_other() -> None:
    """As on two trigger wires, once a lost frame has made the other camera's frames those of the grid."""
    rig = FakeRig(period_ns=PERIOD_NS / 2)
    alive: list[weakref.ref[np.ndarray]] = []
    waited: list[int] = []
    for number in range(200):
        if number == 100:
            rig.pulse(left="missing", right="absent")
        else:
            rig.pulse(right="absent")
        rig.pulse(left="absent")
        rights = [pair.frames["right"] for pair in rig.released if "right" in pair.frames]
        rig.released.clear()
        waited += [number + 1 - shown.frame_id for shown in rights]
        alive += [weakref.ref(shown.pixels) for shown in rights]
    assert len(waited) == 100
    assert max(waited) < 12
    assert set(waited[20:]) == {0}
    assert sum(pixels() is not None for pixels in alive) < 12
