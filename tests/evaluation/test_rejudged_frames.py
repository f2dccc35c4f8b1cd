"""Frames that are exposed again, the timeline they are taken from, and what odometry makes of them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.metrics.contrast import SensorNoise
from evaluation.experiments.rejudge import OFFSETS, measure_still
from evaluation.odometry.stereo import StereoCamera
from evaluation.rejudge import following
from evaluation.rejudge.camera import Exposer, Rectifier, SeenLight
from evaluation.rejudge.drive import ShotGlimpse, Timeline, Watcher, delay_frames
from evaluation.rejudge.following import CommandFollower
from imaging.errors import AutoexposeError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.geometry import CameraGeometry
from imaging.pixels import Pixels
from imaging.response import ResponseFunction

NOISE = SensorNoise(20_000.0, 3.0)
QUIET = SensorNoise(1e7, 0.1)
GAMMA = ResponseFunction(np.log2(np.maximum(np.arange(256), 0.5) / 255) * 1.7, 0, 255)
SHAPE = 60, 80


def frame(pixels: Pixels, setting: ExposureSetting) -> Frame:
    return Frame(pixels, 8 * pixels.itemsize, 0, 0, 0, 0, setting)


def flat(amount: float) -> SeenLight:
    return SeenLight(np.full(SHAPE, amount, np.float32), np.zeros(SHAPE, np.float32))


@pytest.mark.parametrize("response", [ResponseFunction.linear(), GAMMA], ids=["linear", "gamma"])
@given(grey=st.integers(12, 240), stops=st.floats(-2.0, 2.0))
def test_without_noise_a_frame_is_what_the_response_says(response: ResponseFunction, grey: int, stops: float) -> None:
    exposer, setting = Exposer(response, QUIET, 0), ExposureSetting(1000.0, 0.0)
    seen = exposer.light(frame(np.full(SHAPE, grey, np.uint8), setting))
    exposed = exposer.expose(seen, ExposureSetting(1000.0 * 2.0**stops, 0.0), 8, 0)
    wanted = response.intensity(response.inverse(np.array([grey])) + stops)[0]
    assert abs(float(exposed.mean()) - wanted) < 0.6


def test_a_frame_exposed_as_it_was_taken_is_itself() -> None:
    grey = np.arange(4800, dtype=np.int64).reshape(SHAPE) % 250
    taken = frame(grey.astype(np.uint8), ExposureSetting(700.0, 12.0))
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    again = exposer.expose(exposer.light(taken), taken.setting, 8, 3)
    assert np.abs(again.astype(int) - grey).max() <= 1


@pytest.mark.parametrize(("time_us", "gain_db"), [(1000.0, 0.0), (250.0, 12.0), (31.6, 30.0)])
def test_noise_is_what_the_setting_has(time_us: float, gain_db: float) -> None:
    setting = ExposureSetting(time_us, gain_db)
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    exposed = exposer.expose(flat(0.3 * 2.0**-setting.level), setting, 16, 0) / 257.0
    gain = 10 ** (gain_db / 20)
    electrons = 0.3 * NOISE.full_well_e / gain
    wanted = 255 * gain / NOISE.full_well_e * np.sqrt(electrons + NOISE.read_noise_e**2)
    assert exposed.mean() == pytest.approx(0.3 * 255, rel=0.02)
    assert exposed.std() == pytest.approx(wanted, rel=0.1)


def test_noise_that_is_there_already_is_not_added_again() -> None:
    setting = ExposureSetting(500.0, 18.0)
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    first = exposer.expose(flat(0.3 * 2.0**-setting.level), setting, 8, 0)
    again = exposer.expose(exposer.light(frame(first, setting)), setting, 8, 1)
    assert again.std() == pytest.approx(first.std(), rel=0.05)


def test_fused_frames_show_what_none_of_them_shows_alone() -> None:
    """From 1 to 1000 times the darkest light that one frame would resolve."""
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    amount = np.geomspace(1e-7, 1e-4, SHAPE[1], dtype=np.float32)[None].repeat(SHAPE[0], axis=0)
    light = SeenLight(amount, np.zeros(SHAPE, np.float32))
    settings = [ExposureSetting(1000.0, 6.0 * step) for step in range(6)] + [ExposureSetting(8000.0, 0.0)]
    frames = [frame(exposer.expose(light, setting, 8, number), setting) for number, setting in enumerate(settings)]
    fused = exposer.fused(frames)
    error = np.log2(fused.amount.mean(axis=0) / amount[0])
    assert np.abs(error[30:]).max() < 0.15


@pytest.mark.parametrize("codes", [5.0, 10.0, 20.0, 40.0])
def test_what_rounds_to_black_in_most_frames_is_not_made_darker(codes: float) -> None:
    """Grey levels in the brightest frame; 64 times fewer in the darkest, where noise is a hundredth of one."""
    exposer = Exposer(ResponseFunction.linear(), SensorNoise(20_000.0, 1.0), 0)
    settings = [ExposureSetting(1000.0, 6.02 * step) for step in range(5)] + [ExposureSetting(4000.0, 24.08)]
    light = flat(codes / 255 * 2.0 ** -settings[-1].level)
    frames = [frame(exposer.expose(light, setting, 8, number), setting) for number, setting in enumerate(settings)]
    assert exposer.fused(frames).amount.mean() == pytest.approx(light.amount[0, 0], rel=0.08)


@given(st.floats(0.0, 3.0))
def test_what_is_saturated_stays_so_in_a_little_less_light(stops: float) -> None:
    setting = ExposureSetting(1000.0, 0.0)
    exposer = Exposer(ResponseFunction.linear(), QUIET, 0)
    seen = exposer.light(frame(np.full(SHAPE, 255, np.uint8), setting))
    darker = exposer.expose(seen, ExposureSetting(1000.0 * 2.0**-stops, 0.0), 8, 0)
    assert (darker == 255).all() == (stops <= 1.0) or abs(stops - 1.0) < 0.05


def test_frames_of_more_bits_and_colours_keep_their_form() -> None:
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    deep = Frame(np.full((4, 6), 2000, np.uint16), 12, 0, 0, 0, 0, ExposureSetting(1000.0, 0.0))
    assert exposer.expose(exposer.light(deep), deep.setting, 12, 0).dtype == np.uint16
    assert abs(float(exposer.expose(exposer.light(deep), deep.setting, 12, 0).mean()) - 2000) < 20
    colour = Frame(np.full((4, 6, 3), 99, np.uint8), 8, 0, 0, 0, 0, deep.setting, layout="RGB")
    assert exposer.expose(exposer.light(colour), deep.setting, 8, 0).shape == (4, 6, 3)


def test_noise_of_a_frame_is_the_same_whatever_its_setting() -> None:
    exposer, setting = Exposer(ResponseFunction.linear(), NOISE, 0), ExposureSetting(1000.0, 0.0)
    first, again, other = (exposer.expose(flat(3e-4), setting, 8, number) for number in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_frames_of_a_still_scene_are_as_if_really_taken() -> None:
    """Four stops either side of the bracket's middle; the brightest shot is three stops above it."""
    rows = measure_still(scene="leaves", seed=311, frames=28)
    assert [row["offset"] for row in rows] == list(OFFSETS)
    for row in rows:
        assert row["rms"] < 1.0  # grey levels, beyond noise
        assert abs(row["bias"]) < 0.2
        assert row["made_noise"] == pytest.approx(row["noise"], rel=0.25)


CAMERA = StereoCamera(860.0, (359.5, 269.5), 0.08)
UNTURNED = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def geometry(centre_x: float, baseline_m: float) -> CameraGeometry:
    k = (860.0, 0.0, centre_x, 0.0, 860.0, 269.5, 0.0, 0.0, 1.0)
    p = (860.0, 0.0, centre_x, -860.0 * baseline_m, 0.0, 860.0, 269.5, 0.0, 0.0, 0.0, 1.0, 0.0)
    return CameraGeometry(720, 540, "plumb_bob", (0.0,) * 5, k, UNTURNED, p)


def test_columns_that_a_calibration_moves_against_each_other_are_no_depth() -> None:
    """What is infinitely far is on both optical axes: column 359.5 of the left picture, 339.5 of the right one."""
    images = {camera: np.zeros((540, 720), np.uint8) for camera in ("left", "right")}
    images["left"][:, 359:361] = images["right"][:, 339:341] = 200
    setting = ExposureSetting(1000.0, 0.0)
    left, right = (Frame(image, 8, 0, 0, 0, 0, setting) for image in images.values())
    rectifier = Rectifier({"left": geometry(359.5, 0.0), "right": geometry(339.5, 0.08)}, (540, 720))
    seen_left, seen_right = rectifier.images(FrameSet(0, {"left": left, "right": right}))
    assert np.array_equal(seen_left, seen_right)
    assert rectifier.camera.centre_px == (359.5, 269.5)


def test_orb_slam3_is_given_no_file_that_another_process_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[tuple[str, Path]] = []

    def write(file: Path) -> None:
        assert not (tmp_path / "vocabulary.txt").exists()
        file.write_text("words")

    def slam(_camera: StereoCamera, vocabulary: Path, folder: Path, _interval_s: float) -> None:
        given.append((vocabulary.read_text(), folder))

    monkeypatch.setattr(following, "write_taught_vocabulary", write)
    monkeypatch.setattr(following, "OrbSlam3", slam)
    everyone = following.Following(following.ORB_SLAM3, CAMERA, 0.1, tmp_path)
    for name in ("fixed", "neves2009"):
        everyone.begin(name)
    assert given == [("words", tmp_path / "fixed"), ("words", tmp_path / "neves2009")]


def test_what_a_program_complains_about_need_not_be_utf_8(tmp_path: Path) -> None:
    slam = tmp_path / "slam.py"
    slam.write_text("import sys; sys.stderr.buffer.write(b'no vocabulary in m\\xfcll'); sys.exit(3)")
    follower = CommandFollower(f"{sys.executable} {slam}", tmp_path / "pictures", CAMERA)
    with pytest.raises(AutoexposeError, match=r"failed with exit code 3: no vocabulary in m.ll"):
        follower.end()


def test_ctrl_c_ends_the_users_program_too(tmp_path: Path) -> None:
    """It runs below a worker process, and here below a script of the user's, too."""
    lives, slam, main = tmp_path / "lives", tmp_path / "slam.sh", tmp_path / "main.py"
    os.mkfifo(lives)  # open for as long as a program lives
    slam.write_text(f"sh -c 'exec 3>{lives}; echo started >&3; exec sleep 1000'\necho ended\n")
    main.write_text(
        f"""
from pathlib import Path
from evaluation.pool import over_processes
from evaluation.rejudge.following import CommandFollower, StereoCamera

def follow(number):
    CommandFollower("sh {slam}", Path("{tmp_path}", str(number)), StereoCamera(860.0, (359.5, 269.5), 0.08)).end()

if __name__ == "__main__":
    for _ in over_processes(follow, [1, 2], 2):
        pass
"""
    )
    rejudge = subprocess.Popen([sys.executable, main], stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        with lives.open() as programs:
            assert [programs.readline(), programs.readline()] == ["started\n"] * 2
            os.killpg(rejudge.pid, signal.SIGINT)
            assert rejudge.wait() != 0
            assert programs.read() == ""
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(rejudge.pid, signal.SIGKILL)
        rejudge.wait()


LEVELS = (8.0, 10.4, 12.8, 14.0, 11.6, 9.2)
CYCLE = len(LEVELS)
LIGHT = 2.0**-13


def glimpse(
    number: int, median_share: float | None = None, *, repeats: bool | None = None, clipped: float = 0.0
) -> ShotGlimpse:
    setting = ExposureSetting(2.0 ** LEVELS[number % CYCLE], 0.0)
    above = np.full(257, clipped, np.float32)
    median = seen(LIGHT, number) if median_share is None else median_share
    return ShotGlimpse(number, number / 60, setting, 3.0, 0.2, setting, above, median, repeats)


def seen(light: float, number: int) -> float:
    """What the median pixel of a shot is in a light, as a share of full scale."""
    return float(np.clip(light * 2.0 ** LEVELS[number % CYCLE], 0.0, 1.0))


@given(st.integers(2, 40), st.sampled_from([2.0**5, 2.0**-5, 2.0**2, 2.0**-2]))
def test_a_jump_of_the_light_is_found_where_it_is(at: int, factor: float) -> None:
    light = [1e-4 * (factor if number >= at else 1.0) for number in range(60)]
    timeline = Timeline.of([glimpse(number, seen(light[number], number)) for number in range(60)], CYCLE)
    jumps = [number for number in range(1, 60) if timeline.sections[number] != timeline.sections[number - 1]]
    assert len(jumps) == 1
    assert abs(jumps[0] - at) <= 2  # shots in between that both lights explain may belong to either
    for number in range(60):
        assert all(timeline.sections[shot] == timeline.sections[number] for shot in timeline.near(number))
        assert number in timeline.near(number)


def test_a_light_that_only_drifts_has_no_jump() -> None:
    light = 1e-4 * 2.0 ** np.linspace(0.0, 4.0, 120)
    timeline = Timeline.of([glimpse(number, seen(light[number], number)) for number in range(120)], CYCLE)
    assert set(timeline.sections) == {0}


def test_in_motion_the_nearest_shot_stands_for_an_exposure() -> None:
    timeline = Timeline.of([glimpse(number) for number in range(36)], CYCLE)
    assert timeline.nearest(18, 10.3) == 19  # level 10.4, a frame later
    assert timeline.nearest(18, 5.0) == 18  # darker than all: the darkest, near in time
    assert timeline.glimpses[timeline.nearest(18, 20.0)].level == 14.0


def test_a_brighter_shot_that_saturates_more_than_wanted_does_not() -> None:
    clipped = {14.0: 0.3, 12.8: 0.2}
    glimpses = [glimpse(number, clipped=clipped.get(LEVELS[number % CYCLE], 0.0)) for number in range(36)]
    timeline = Timeline.of(glimpses, CYCLE)
    assert timeline.glimpses[timeline.nearest(18, 12.6)].level == 11.6


def test_only_what_repeats_for_a_cycle_is_still() -> None:
    repeats = [None] * CYCLE + [True] * 30 + [False] * 3 + [True] * 30
    timeline = Timeline.of([glimpse(number, repeats=answer) for number, answer in enumerate(repeats)], CYCLE)
    assert all(timeline.still[:20])
    assert not any(timeline.still[CYCLE + 24 : CYCLE + 36])
    assert timeline.motion_px(3) == 0.0
    assert timeline.motion_px(CYCLE + 31) == 3.0


def test_glimpses_tell_still_from_moving_pictures() -> None:
    rng = np.random.default_rng(1)
    scene = np.kron(rng.uniform(1e-5, 9e-5, (60, 80)), np.ones((9, 9)))
    decision = Decision(ExposureSetting(1000.0, 0.0), 10.0, "", 0.1, 0.0, 0.0, 0.0)

    def watch(shift_px: int) -> list[bool | None]:
        watcher = Watcher({"left": ResponseFunction.linear()}, 2)
        answers = []
        for number in range(8):
            setting = ExposureSetting((4000.0, 9000.0)[number % 2], 0.0)
            light = np.roll(scene, shift_px * number, axis=1) * 2.0**setting.level
            grey = np.clip(255 * light + rng.normal(0, 1, light.shape), 0, 255).astype(np.uint8)
            frame = Frame(grey, 8, number, 0, 0, 0, setting)
            answers.append(watcher.look(FrameSet(number, {"left": frame}), decision, number / 60).repeats)
        return answers

    assert watch(0) == [None, None, *[True] * 6]
    assert watch(3) == [None, None, *[False] * 6]


def test_the_delay_is_found_from_settings() -> None:
    settings = [ExposureSetting(100.0 * 1.3 ** (number % CYCLE), 0.0) for number in range(40)]
    for delay in (1, 2, 3):
        glimpses = [
            ShotGlimpse(n, n / 60, settings[n], 0.0, 0.1, settings[n + delay], np.zeros(257, np.float32), 0.3, None)
            for n in range(30)
        ]
        assert delay_frames(glimpses) == delay
