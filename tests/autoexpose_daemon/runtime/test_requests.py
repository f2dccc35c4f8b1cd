"""Requests to control, on virtual cameras and a virtual wire: what changes, for which pairs, and what does not."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.request import new_request
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.step import NO_OVERRIDE, Override, StepInputs
from autoexpose_daemon.runtime.requests import PendingShot, Requests
from autoexpose_daemon.runtime.setup import ActiveLoop, Tuning
from autoexpose_daemon.status.counters import Answer, RequestTally
from drivers.camera import CameraDescription
from drivers.rig.events import CameraReady
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES
from imaging.pixels import PixelFormat
from tests.autoexpose_daemon import virtual
from tests.autoexpose_daemon.virtual import START_US, SteadyLoop, SteadyTuning, VirtualRun, tuning

SHOT = ExposureSetting(500.0, 3.0)


class ObedientLoop(SteadyLoop):
    """Decides on what stands above the policy, and keeps it."""

    def __init__(self, limits: ExposureLimits, setting: ExposureSetting, overrides: list[Override]) -> None:
        super().__init__(limits, setting)
        self._overrides = overrides

    def check_ev(self, ev_stops: float) -> None:
        if ev_stops > 2:
            raise ConfigurationError("too bright")

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        override = StepInputs.of(inputs).override
        self._overrides.append(override)
        asked = override.shot or override.held
        return self._decision if asked is None else Decision(asked, asked.level, "asked", 0.5, 0.0, 0.0, 0.0)


class ObedientTuning(SteadyTuning):
    overrides: list[Override]

    def loop(self, limits: ExposureLimits) -> ObedientLoop:  # type: ignore[override]
        return ObedientLoop(limits, self.config.start, self.overrides)


class Rig(VirtualRun):
    """A run whose loop does as it is asked."""

    def __init__(self) -> None:
        self.overrides: list[Override] = []
        super().__init__()

    def use(self, exposure_time_us: float = START_US) -> None:
        obedient = ObedientTuning(tuning(exposure_time_us).config)
        obedient.overrides = self.overrides
        self.rig.control.tune(obedient)

    def request(self, **changes: Any) -> Future[Answer]:
        answer: Future[Answer] = Future()
        self.rig.control.ask(new_request({"by": "user@robot", **changes}), answer)
        return answer

    def settings(self, since: int) -> list[set[ExposureSetting]]:
        return [{frame.setting for frame in pair.frames.values()} for pair in self.pairs[since:]]


@pytest.fixture
def run() -> Rig:
    rig = Rig()
    rig.use()
    rig.let_pass(20)
    rig.overrides.clear()
    return rig


def shot(run: Rig) -> Future[Answer]:
    return run.request(shot={"exposure_time_us": SHOT.exposure_time_us, "gain_db": SHOT.gain_db})


def test_a_shot_is_one_pair_which_the_policy_is_not_shown_and_the_account_is_right(run: Rig) -> None:
    since = len(run.pairs)
    answer = shot(run)
    run.wait_until(answer.done, "the shot")
    run.let_pass(20)
    taken = answer.result().shot
    assert taken is not None
    (pair,) = [pair for pair in run.pairs[since:] if SHOT in {frame.setting for frame in pair.frames.values()}]
    assert {frame.setting for frame in pair.frames.values()} == {SHOT}
    assert (taken.trigger, taken.setting) == (pair.trigger, SHOT)
    assert taken.frame_ids == {camera: frame.frame_id for camera, frame in pair.frames.items()}
    assert [override.shot for override in run.overrides if override.shot] == [SHOT]
    (unseen,) = [override for override in run.overrides if override.unseen]
    assert unseen.held == ExposureSetting(START_US, 0.0)
    assert run.counted() == {}
    assert run.telemetry.counts.mismatched_pairs == 0


def test_a_shot_is_rounded_to_the_increments_of_the_cameras(run: Rig) -> None:
    answer = run.request(shot={"exposure_time_us": 500.4, "gain_db": 3.04})
    run.wait_until(answer.done, "the shot")
    assert answer.result().shot.setting == SHOT  # type: ignore[union-attr]
    assert run.counted() == {}


def test_shots_in_a_row_are_each_one_pair(run: Rig) -> None:
    since = len(run.pairs)
    for _ in range(5):
        answer = shot(run)
        run.wait_until(answer.done, "a shot")
    run.let_pass(20)
    assert run.settings(since).count({SHOT}) == 5
    assert run.counted() == {}


@pytest.mark.parametrize("periods", [0.3, 0.9, 1.4, 3.0])
def test_a_shot_that_is_slow_to_be_written_is_not_overtaken(run: Rig, periods: float) -> None:
    """The nodes threads come to nothing for so long."""
    since = len(run.pairs)
    answer = shot(run)
    for unit in run.rig.units.values():
        unit.nodes.hold(run.rig.clock.now_ns + round(periods * 1e9 / 60))
    run.wait_until(answer.done, "the shot")
    assert answer.result().shot is not None
    run.let_pass(20)
    assert 1 <= sum(SHOT in settings for settings in run.settings(since)) <= 2
    assert run.settings(since)[-1] == {ExposureSetting(START_US, 0.0)}


def test_a_shot_that_no_frame_shows_fails_and_control_goes_on(run: Rig) -> None:
    run.wire.stop_periods = 300
    run.let_pass(2)
    answer = shot(run)
    run.wait_until(answer.done, "the end of patience")
    with pytest.raises(AutoexposeError, match="the shot failed: no frame was taken with it in time"):
        answer.result()
    assert run.rig.control.first.requests.shot is None


@pytest.mark.parametrize("lost", ["left", "right"])
def test_a_shot_of_which_a_frame_is_lost_is_the_next_pair(run: Rig, lost: str) -> None:
    answer, device = shot(run), {"left": run.left, "right": run.right}[lost]
    run.wait_until(lambda: device.written == SHOT, "its setting")
    device.lose = 1
    run.wait_until(answer.done, "the shot")
    taken = answer.result().shot
    assert taken is not None
    (pair,) = [pair for pair in run.pairs if pair.trigger == taken.trigger]
    assert taken.frame_ids == {camera: frame.frame_id for camera, frame in pair.frames.items()}
    assert {frame.setting for frame in pair.frames.values()} == {SHOT}


@pytest.mark.parametrize("lost", ["left", "right"])
def test_a_frame_that_is_used_alone_does_not_answer_a_shot(run: Rig, lost: str) -> None:
    answer, device = shot(run), {"left": run.left, "right": run.right}[lost]
    run.wait_until(lambda: device.written == SHOT, "its setting")
    device.lose = 40
    run.let_pass(45)
    assert not answer.done()
    run.wait_until(answer.done, "the end of patience")
    with pytest.raises(AutoexposeError, match=f"the shot failed: no frame of the {lost} camera was taken with it"):
        answer.result()


def test_a_shot_with_one_camera_gone_is_one_frame(run: Rig) -> None:
    run.right.present = False
    run.wait_for_state("right camera gone")
    answer = shot(run)
    run.wait_until(answer.done, "the shot")
    taken = answer.result().shot
    assert taken is not None and list(taken.frame_ids) == ["left"]


def test_one_shot_at_a_time(run: Rig) -> None:
    first, second = shot(run), shot(run)
    with pytest.raises(ConfigurationError, match="another shot is under way"):
        second.result(0)
    run.wait_until(first.done, "the first")


def test_lock_holds_the_setting_decided_on_last_even_through_a_shot_and_another_policy(run: Rig) -> None:
    answer = run.request(locked=True).result(0)
    held = ExposureSetting(START_US, 0.0)
    assert answer.requests.locked == held
    run.request(policy="begin2022").result(0)
    run.overrides.clear()
    waiting = shot(run)
    run.wait_until(waiting.done, "the shot")
    run.let_pass(10)
    assert {override.held for override in run.overrides} == {held}
    assert run.request(locked=False).result(0).requests.locked is None
    run.overrides.clear()
    run.let_pass(5)
    assert set(run.overrides) == {NO_OVERRIDE}


def test_a_request_is_all_or_nothing(run: Rig) -> None:
    refused = run.request(locked=True, policy="neves2009", ev_stops=2.5)
    with pytest.raises(ConfigurationError, match="too bright"):
        refused.result(0)
    answer = run.request().result(0)
    assert (answer.policy, str(answer.requests)) == (tuning(START_US).config.control.policy, "")
    assert (answer.requests.taken, answer.requests.refused) == (0, 1)


def test_a_reload_puts_back_the_configuration_and_says_so(run: Rig, caplog: pytest.LogCaptureFixture) -> None:
    run.request(locked=True, ev_stops=1.0, policy="neves2009", limits={"max_gain_db": 20.0}).result(0)
    waiting = shot(run)
    with caplog.at_level("INFO"):
        run.use()
    assert "the configuration replaces what was requested: locked at 2000 us, 0.0 dB, EV +1, policy changed, " in (
        caplog.text
    )
    with pytest.raises(AutoexposeError, match="the configuration was reloaded meanwhile"):
        waiting.result(0)
    answer = run.request().result(0)
    assert str(answer.requests) == ""
    assert answer.requests.bounds is not None and answer.requests.bounds.max_gain_db == 30.0


OPENED = CameraReady(
    "left",
    CameraDescription("Maker", "Model", "L", pixel_format=PixelFormat.MONO8, size=(720, 540)),
    ExposureLimits(20.0, 5000.0, 0.0, 30.0),
)


def test_the_bounds_are_known_and_requests_taken_from_when_a_camera_is_open() -> None:
    control = virtual.VirtualRig(7, lambda *_: None, lambda *_: None, tuning(START_US)).control
    answer: Future[Answer] = Future()
    control.ask(new_request({"by": "ana", "locked": True}), answer)
    with pytest.raises(ConfigurationError, match="not every camera has been open yet"):
        answer.result(0)
    control.take([OPENED])
    assert control.telemetry.requests.bounds is not None
    assert control.telemetry.requests.bounds.max_time_us == 5000.0


def test_a_region_is_not_taken_for_a_camera_that_was_never_open_or_is_not_there() -> None:
    active = ActiveLoop(Tuning(tuning(START_US).config))
    active.ready(OPENED)
    requests = Requests(active, RequestTally(), ExposureSetting(START_US, 0.0), 1e9 / 60)
    region: dict[str, Any] = {"rectangles": [{"box": [0, 0, 1000, 1000]}]}
    for camera, why in (("left", r"reaches to pixel \(1000, 1000\)"), ("right", "not every camera has been open yet")):
        answer: Future[Answer] = Future()
        requests.ask(new_request({"by": "user", "region": {camera: region}}), answer, 0)
        with pytest.raises(ConfigurationError, match=why):
            answer.result(0)
    alone = Config.model_validate({"cameras": {"left": {"serial": "1"}}})
    with pytest.raises(ConfigurationError, match=r"region.right: the rig has no right camera"):
        SteadyTuning(alone).changed(new_request({"by": "ana", "region": {"right": region}}))


def test_reset_does_the_same_and_what_else_is_asked_for_comes_after_it(run: Rig) -> None:
    run.request(locked=True, policy="neves2009", region={"left": {"rectangles": [{"box": [0, 0, 9, 9]}]}}).result(0)
    answer = run.request(reset=True, ev_stops=-1).result(0)
    assert str(answer.requests) == "EV -1"
    assert answer.requests.latest == "reset, EV -1, asked by user@robot"


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"limits": {"max_time_us": 20_000}}, "exposure.max_time_us 20000 us does not fit into the 16667 us"),
        ({"limits": {"min_time_us": 7_000, "max_time_us": 6_000}}, "7000 to 6000 us leave no exposure time to choose"),
        (
            {"limits": {"max_time_us": 100}, "policy": "fixed"},
            r"control.start 2000 us, 0.0 dB is outside the bounds of exposure",
        ),
        ({"shot": {"exposure_time_us": 9_000}}, r"shot 9000 us, 0 dB is out of bounds: give 20 to 7500 us, 0 to "),
        ({"region": {"left": {"rectangles": [{"box": [0, 0, 9, 9], "weight": 0}]}}}, "region.left: no pixel counts"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(run: Rig, changes: dict[str, Any], why: str) -> None:
    with pytest.raises(ConfigurationError, match=why):
        run.request(**changes).result(0)
    assert str(run.request().result(0).requests) == ""


def test_a_request_that_was_withdrawn_changes_nothing(run: Rig) -> None:
    answer: Future[Answer] = Future()
    assert answer.cancel()
    run.rig.control.ask(new_request({"by": "ana", "locked": True}), answer)
    assert str(run.request().result(0).requests) == ""


def test_every_change_is_logged_with_who_asked(run: Rig, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO"):
        run.request(locked=True, ev_stops=0).result(0)
        run.request().result(0)
    assert "lock, EV 0, asked by user@robot" in caplog.messages
    assert len(caplog.messages) == 1


def pair_of(trigger: int, *shown: CameraName, cameras: Sequence[CameraName] = SIDES) -> FrameSet:
    """A pair whose frames of the sides in `shown` are of the shot."""
    pixels, other = np.zeros((1, 1), np.uint8), ExposureSetting(START_US, 0.0)
    settings = {camera: SHOT if camera in shown else other for camera in cameras}
    return FrameSet(trigger, {camera: Frame(pixels, 8, trigger, 0, 0, 0, it) for camera, it in settings.items()})


def pending_shot(*cameras: CameraName) -> PendingShot:
    pending = PendingShot(SHOT, 10**9, Future(), SIDES)
    pending.decided([], cameras)
    return pending


def test_a_shot_in_a_pair_that_control_had_no_time_for_is_found() -> None:
    pending = pending_shot("left")
    assert pending.is_in(pair_of(6, "left", cameras=["left"])) and not pending.is_in(pair_of(7, cameras=["left"]))
    found = pending.found()
    assert found is not None and (found.trigger, found.frame_ids) == (6, {"left": 6})


@pytest.mark.parametrize(("first", "late"), [("left", "right"), ("right", "left")])
def test_a_shot_that_is_split_over_two_pairs_has_the_trigger_of_its_left_frame(
    first: CameraName, late: CameraName
) -> None:
    pending = pending_shot(*SIDES)
    assert pending.is_in(pair_of(6, first)) and pending.is_in(pair_of(7, late))
    found = pending.found()
    assert found is not None
    assert found.trigger == found.frame_ids["left"] == (7 if late == "left" else 6)


def test_a_shot_whose_cameras_are_all_gone_fails_in_a_whole_sentence() -> None:
    pending = pending_shot(*SIDES)
    pending.is_in(pair_of(6, "left", cameras=["left"]))
    assert pending.why_late.startswith("no frame of the right camera was taken")
    for camera in SIDES:
        pending.gone(camera)
    assert pending.why_late.startswith("no frame was taken with it in time")
