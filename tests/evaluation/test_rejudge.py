"""`rejudge` from end to end."""

from __future__ import annotations

import itertools
import json
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.recording.file import RecordingFile, Step
from autoexpose_daemon.recording.replay import report_replay
from calibration.geometry.opencv import ros_yaml
from evaluation.experiments.rejudge import simulated_geometries, simulated_setup
from evaluation.odometry.tracking import lap, odometry_stage
from evaluation.rejudge.decide import FEWEST_SEGMENTS, Margins
from evaluation.rejudge.fleet import JudgedDrive, JudgedFleet
from evaluation.rejudge.following import ReferenceTrajectory, Trajectory, read_tum, tum
from evaluation.rejudge.rejudge_app import rejudge
from evaluation.rejudge.segments import parts_of
from evaluation.rejudge.sources import Survey, read_drive, read_recording
from evaluation.stage.camera import DelayedLoop
from evaluation.stage.rendering import Stage
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.frames import FrameSet
from imaging.geometry import CameraGeometry
from tests.autoexpose_daemon.recording.runs import as_in_fourteenth, copy

FRAMES = 36
BEGIN_S = 4.0  # in full motion


def moving_stage() -> Stage:
    stage = odometry_stage("even", 1, 1, 0)
    stage._start_times_s = BEGIN_S + np.arange(FRAMES) / 60.0
    return stage


@pytest.fixture(scope="session")
def drive_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording in brackets of the simulated rig in motion, in four shots to a cycle."""
    path = tmp_path_factory.mktemp("rejudge") / "drive.mcap"
    setup = simulated_setup(Bracketing(4, 4.0))
    stage, delayed = moving_stage(), DelayedLoop(ControlLoop(setup), 2)
    file = RecordingFile(path, "rig")
    for number in range(FRAMES):
        stage.go_to(number)
        pair = delayed.step(stage.take)
        copies = {camera: replace(frame, pixels=frame.pixels.copy()) for camera, frame in pair.frames.items()}
        inputs, geometries = StepInputs(FrameSet(number, copies)), simulated_geometries()
        step = Step(number + 1, 2, inputs, delayed.decisions[-1], calibrations=geometries)
        file.write(step, setup, delayed.loop.state() if number == 0 else None)
    file.close(FRAMES, 0)
    return path


app = typer.Typer()
app.command()(rejudge)

QUICK = ("--policies", "neves2009", "--jobs", "1")
FIRST_STEADY = 8
"""From this shot on the ladder of the drive stays where it is."""


def run(*arguments: object) -> Result:
    """Without what is kept from earlier."""
    with tempfile.TemporaryDirectory() as kept:
        return CliRunner().invoke(app, [*map(str, arguments), "--kept", kept])


def said(*arguments: object) -> str:
    """What a command that fails says."""
    outcome = run(*arguments)
    assert isinstance(outcome.exception, AutoexposeError), outcome.output
    return str(outcome.exception)


def true_trajectory() -> Trajectory:
    times_s = np.arange(BEGIN_S - 0.1, BEGIN_S + FRAMES / 60 + 0.1, 0.005)
    path = lap(1)
    return Trajectory(times_s, np.array([path.pose(float(time_s)) for time_s in times_s]))


def of_the_drive(trajectory: Trajectory, drive_file: Path) -> Trajectory:
    """With the times of the recording, which was stamped when it was written."""
    first = read_recording(drive_file).timeline.glimpses[0]
    begin_s = BEGIN_S + first.setting.exposure_time_us / 2e6
    return Trajectory(trajectory.times_s - begin_s + first.time_s, trajectory.poses)


def test_policies_are_judged_and_one_is_recommended(drive_file: Path, tmp_path: Path) -> None:
    truth, page, figures = tmp_path / "true.tum", tmp_path / "page.html", tmp_path / "figures.json"
    truth.write_text(tum(of_the_drive(true_trajectory(), drive_file)))
    chosen = ("--policies", f"{DEFAULT_POLICY},neves2009", "--present", DEFAULT_POLICY, "--jobs", "1")
    outcome = run(drive_file, *chosen, "--trajectory", truth, "--json", figures, "--report", page)
    assert outcome.exit_code == 0, outcome.exception
    assert "36 pairs in 0.6 s, 4 to a cycle, 0 missing" in outcome.output.replace("\n", " ")
    written = json.loads(figures.read_text())
    assert [one["policy"] for one in written["policies"]] == [DEFAULT_POLICY, "neves2009"]
    for one in written["policies"]:
        assert 0.05 < one["metric"] < 0.5
        assert one["matches"] > 30
        assert 0.0 < one["rpe_mm"] < 10.0
    assert written["recommended"] == written["present"] == DEFAULT_POLICY  # half a second decides nothing
    assert written["decision"]["policy"] is None and f"stay with {DEFAULT_POLICY}" in written["decision"]["why"]
    assert written["section"] in outcome.output and DEFAULT_POLICY in written["section"]
    (drive,) = written["drives"]
    assert drive["segments"] == 1 and [one["policy"] for one in drive["policies"]] == [DEFAULT_POLICY, "neves2009"]
    text = page.read_text()
    assert text.count("<img") == 6  # the worst ten seconds of the other, side by side
    assert f"Stay with {DEFAULT_POLICY}" in text and "http" not in text


def test_a_policy_with_a_lower_limit_is_a_contender_of_its_own(drive_file: Path, tmp_path: Path) -> None:
    limited = "neves2009:max_gain_db=2:max_time_us=400"
    outcome = run(drive_file, "--policies", limited, "--present", "fixed", "--json", tmp_path / "f.json")
    assert outcome.exit_code == 0, outcome.exception
    written = json.loads((tmp_path / "f.json").read_text())
    figures = {one["policy"]: one for one in written["policies"]}
    assert figures.keys() == {"fixed", "neves2009", limited}  # the policy itself is judged with it
    assert figures[limited]["exposure_time_us"] <= 400 < figures["neves2009"]["exposure_time_us"]
    assert figures[limited]["gain_db"] <= 2
    assert "max_time_us: 7500" in written["section"]  # no evidence, no other limit


def test_the_section_has_the_limit_of_what_is_recommended(drive_file: Path) -> None:
    survey, limited = Survey.of(drive_file), "neves2009:max_gain_db=12:max_time_us=3000"
    about = {"limits": survey.limits, "start": {"exposure_time_us": 5000.0, "gain_db": 0.0}}
    darker = {**about, "limits": {**survey.limits, "max_time_us": 6000.0}}

    def section(*abouts: object) -> str:
        def results(matches: float) -> list[object]:
            figures = {"rpe_mm": None, "lost_share": 0.0}
            return [
                {"figures": {**figures, "matches": matches + place}, "about": each}
                for place, each in enumerate(abouts * FEWEST_SEGMENTS)
            ]

        drives = [JudgedDrive(drive_file, survey, "all", {"fixed": results(200.0), limited: results(400.0)})]
        fleet = JudgedFleet(drives * len(abouts), ["fixed", limited], "fixed", Margins(), [])
        assert fleet.decision().policy == limited
        return fleet.section

    assert section(about) == (
        "control:\n  policy: neves2009\n  start: {exposure_time_us: 3000, gain_db: 4.43697}\n"
        "exposure:\n  min_time_us: 20\n  max_time_us: 3000\n  min_gain_db: 0\n  max_gain_db: 12\n"
    )
    assert section(about, darker) == (
        "control:\n  policy: neves2009\nexposure:\n  max_gain_db: 12\n  max_time_us: 3000\n"
    )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("fishy:max_time_us=3000", "there is no policy 'fishy'"),
        ("belief:min_time_us=3", "'min_time_us=3' alters nothing that can be judged: give max_time_us or max_gain_db"),
        ("belief:max_time_us", "'max_time_us' alters nothing"),
        ("belief:max_time_us=x", "'max_time_us=x' alters nothing"),
        ("belief:max_gain_db=nan", "'max_gain_db=nan' alters nothing"),
        ("belief:max_gain_db=1:max_gain_db=2", "'max_gain_db=2' alters nothing.*each once"),
        ("belief:max_time_us=8000", "drive.mcap: belief:max_time_us=8000.*max_time_us 7500: only lower limits"),
        ("belief:max_time_us=3", "drive.mcap: .*20 to 3 us leave no exposure time"),
    ],
)
def test_what_alters_nothing_that_can_be_judged_is_refused(drive_file: Path, name: str, words: str) -> None:
    assert re.search(words, said(drive_file, "--policies", f"fixed,{name}"))


def program(tmp_path: Path, *lines: str) -> str:
    """A command that knows the folder of the pictures, their times, and where the trajectory is to be written."""
    begin = (
        "import pathlib, sys",
        "folder, written = map(pathlib.Path, sys.argv[-2:])",
        "times = (folder / 'times.txt').read_text().split()",
        "poses = [f'{time} {i / 100} 0 0 0 0 0 1\\n' for i, time in enumerate(times)]",
    )
    (tmp_path / "slam.py").write_text("\n".join([*begin, *lines]))
    return f"{sys.executable} {tmp_path / 'slam.py'}"


def test_the_users_own_program_follows_the_camera(drive_file: Path, tmp_path: Path) -> None:
    slam = program(
        tmp_path,
        "assert len(list((folder / 'left').iterdir())) == len(list((folder / 'right').iterdir())) == len(times)",
        "assert 'focal_px: 860.0' in (folder / 'camera.yaml').read_text()",
        "written.write_text(''.join(poses))",
    )
    outcome = run(drive_file, *QUICK, "--odometry", slam, "--json", tmp_path / "f.json")
    assert outcome.exit_code == 0, outcome.exception
    assert all(one["lost_share"] == 0.0 for one in json.loads((tmp_path / "f.json").read_text())["policies"])


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("sys.exit('no vocabulary')", "failed with exit code 1: no vocabulary"),
        ("pass", "did not write the trajectory that its last argument names"),
        ("written.write_text('1 2 3')", "line 1 is not `time x y z qx qy qz qw`"),
        (
            "written.write_text('1 0 0 0 0 0 0 1\\n2 0 0 0 0 0 0 1')",
            "is not of this drive: its times are 1.000 to 2.000 s",
        ),
        ("written.write_text('')", "tracks nothing on the best shots: give a reference, --trajectory"),
    ],
)
def test_a_program_that_fails_is_named(drive_file: Path, tmp_path: Path, code: str, words: str) -> None:
    assert words in said(drive_file, *QUICK, "--odometry", program(tmp_path, code))


def test_a_policy_under_which_the_program_tracks_nothing_is_lost(drive_file: Path, tmp_path: Path) -> None:
    slam = program(
        tmp_path,
        "known = {'fixed': 0, 'neves2009': 1}.get(folder.name)",
        "written.write_text(''.join(poses[:known]))",
    )
    policies = ("--policies", "fixed,kim2018,neves2009", "--jobs", "1")
    outcome = run(drive_file, *policies, "--odometry", slam, "--json", tmp_path / "f.json")
    assert outcome.exit_code == 0, outcome.exception
    result = json.loads((tmp_path / "f.json").read_text())
    assert [one["lost_share"] for one in result["policies"]] == [1.0, 0.0, 1.0]
    assert [one["rpe_mm"] is None for one in result["policies"]] == [True, False, True]
    assert (result["recommended"], result["decision"]["policy"]) == (result["present"], None)
    rows = [line.split()[0] for line in outcome.output.splitlines() if "%" in line]
    assert rows.index("kim2018") < min(rows.index("fixed"), rows.index("neves2009"))


def test_a_drive_that_was_recorded_under_former_names_is_judged_alike(drive_file: Path, tmp_path: Path) -> None:
    former = copy([drive_file], tmp_path / "drive.mcap", as_in_fourteenth)
    found, figures = [], tmp_path / "figures.json"
    for file in (drive_file, former):
        assert run(file, *QUICK, "--json", figures).exit_code == 0
        found.append(json.loads(figures.read_text())["policies"])
    assert found[0] == found[1]


def test_a_fleet_is_judged_by_groups_and_what_is_damaged_is_left_out(drive_file: Path, tmp_path: Path) -> None:
    content = drive_file.read_bytes()
    folder = tmp_path / "drives/robot1"
    folder.mkdir(parents=True)
    for name in ("a", "b"):
        (folder / f"{name}.mcap").write_bytes(content)
    (folder / "c.mcap").write_text("not a recording")
    (folder / "short.mcap").write_bytes(content[: len(content) // 4])
    (tmp_path / "list.txt").write_text("# of today\ndrives/robot1/a.mcap\n")
    (tmp_path / "groups.csv").write_text("a.mcap,north\nb.mcap,south\n")
    given = (tmp_path / "drives", tmp_path / "list.txt", "--policies", "fixed,neves2009", "--present", "fixed")
    written_to = ("--json", tmp_path / "f.json", "--report", tmp_path / "page.html")
    outcome = run(*given, "--groups", tmp_path / "groups.csv", *written_to)
    assert outcome.exit_code == 0, outcome.exception
    written = json.loads((tmp_path / "f.json").read_text())
    assert [Path(drive["drive"]).name for drive in written["drives"]] == ["a.mcap", "b.mcap"]
    one, other, both = (
        [{name: value for name, value in each.items() if name != "rpe_parts_mm"} for each in rows]
        for rows in (*(drive["policies"] for drive in written["drives"]), written["policies"])
    )
    assert one == other == both
    assert "c.mcap is not an MCAP file" in written["refused"][0].replace(":", "")
    assert re.search(r"short.mcap: has \d+ complete pairs: give at least 12", written["refused"][1])
    assert "left out" in outcome.output and set(written["groups"]) == {"north", "south"}
    assert written["intervals"].keys() == {"neves2009"}
    page = (tmp_path / "page.html").read_text()
    for name, group in (("a.mcap", "north"), ("b.mcap", "south")):
        row = page.split(f"<td>{name}</td>")[1].split("</tr>")[0]
        assert all(word in row for word in ("0.0&nbsp;min", group, "undecided", "neves2009"))


def test_a_part_of_a_recording_is_read_from_a_mark(drive_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("evaluation.rejudge.sources.MARKS_S", 0.1)
    survey, part = Survey.of(drive_file), (20, 34)
    near = survey.near(part[0])
    assert near is not None and 0 < near[0] <= part[0] and len(survey.marks) > 2
    found = [read_drive(drive_file, part, mark) for mark in (None, near)]
    for whole, marked in zip(*(drive.source() for drive in found), strict=True):
        assert whole.trigger == marked.trigger
        for camera, frame in whole.frames.items():
            assert np.array_equal(frame.pixels, marked.frames[camera].pixels)
    assert repr(found[0].timeline) == repr(found[1].timeline) and found[0].geometries == found[1].geometries


def test_a_drive_is_cut_into_ten_seconds() -> None:
    times_s = np.arange(0.0, 34.0, 0.1)
    assert parts_of(times_s.tolist()) == [(0, 100), (100, 200), (200, 340)]
    assert parts_of(np.arange(0.0, 36.0, 0.1).tolist())[-1] == (300, 360)
    assert parts_of([5.0, 5.1]) == [(0, 2)]
    rare_s = [*np.arange(0.0, 10.0, 0.5), *np.arange(10.0, 20.0, 2.0), *np.arange(20.0, 50.0, 0.5)]
    assert parts_of(rare_s, 18) == [(0, 20), (20, 45), (45, 65), (65, 85)]


def test_what_cannot_be_judged_is_refused_in_a_sentence(drive_file: Path, tmp_path: Path) -> None:
    damaged, short, text = tmp_path / "damaged.mcap", tmp_path / "short.mcap", tmp_path / "text.mcap"
    content = drive_file.read_bytes()
    damaged.write_bytes(content[: len(content) // 2] + bytes(1000) + content[len(content) // 2 + 1000 :])
    short.write_bytes(content[: len(content) // 6])
    text.write_text("not a recording")
    assert "is damaged" in said(damaged, *QUICK)
    assert "complete pairs: record" in said(short, *QUICK) or "give at least 12" in said(short, *QUICK)
    assert "is not an MCAP file" in said(text, *QUICK)
    assert "cannot be read: No such file" in said(tmp_path / "none.mcap", *QUICK)
    assert "there is no policy 'fishy'" in said(drive_file, "--policies", "fishy")
    assert "no-such-slam is no program" in said(drive_file, *QUICK, "--odometry", "no-such-slam --fast")
    assert "cannot be written" in said(drive_file, *QUICK, "--json", tmp_path / "none" / "f.json")
    assert "name a .html file" in said(drive_file, *QUICK, "--report", drive_file)
    assert "name a .json file" in said(drive_file, *QUICK, "--json", drive_file)
    assert drive_file.read_bytes() == content


def test_a_trajectory_of_another_time_is_refused(drive_file: Path, tmp_path: Path) -> None:
    later = of_the_drive(true_trajectory(), drive_file)
    file = tmp_path / "later.tum"
    file.write_text(tum(Trajectory(later.times_s + 1e6, later.poses)))
    assert "covers 0 of the 36 pairs of the drive" in said(drive_file, *QUICK, "--trajectory", file)


def test_a_recording_without_brackets_is_refused(
    drive_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = read_recording(drive_file).setup
    monkeypatch.setattr("evaluation.rejudge.sources._setup", lambda _path: setup.of_policy("fixed"))
    assert "was not recorded in brackets: record the drive with `record --bracket`" in said(drive_file, *QUICK)


def test_a_bracketed_recording_replays_bit_for_bit_and_through_another_policy(drive_file: Path) -> None:
    lines: list[str] = []
    assert report_replay(drive_file, None, lines.append)
    assert "of which 35 are bit for bit as recorded" in "\n".join(lines)
    assert report_replay(drive_file, "neves2009", lines.append)


def test_a_folder_of_images_is_judged_as_its_recording_is(drive_file: Path, tmp_path: Path) -> None:
    drive = read_recording(drive_file)
    rows = ["file,side,time_s,exposure_time_us,gain_db"]
    for number, pair in itertools.islice(enumerate(drive.source()), FIRST_STEADY, FIRST_STEADY + 14):
        for camera, frame in pair.frames.items():
            cv2.imwrite(str(tmp_path / f"{camera}{number}.png"), frame.pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            setting = frame.setting
            rows.append(f"{camera}{number}.png,{camera},{number / 60},{setting.exposure_time_us},{setting.gain_db}")

    def write(rows: list[str], right: CameraGeometry = drive.geometries["right"], encoding: str = "utf-8") -> None:
        (tmp_path / "frames.csv").write_text("\n".join(rows), encoding=encoding)
        (tmp_path / "right.yaml").write_text(ros_yaml(right, "right"))

    write(rows)
    (tmp_path / "left.yaml").write_text(ros_yaml(drive.geometries["left"], "left"))
    outcome = run(tmp_path, *QUICK, "--json", tmp_path / "f.json")
    assert outcome.exit_code == 0, outcome.exception
    assert all(one["matches"] > 30 for one in json.loads((tmp_path / "f.json").read_text())["policies"])
    write(rows, drive.geometries["left"])
    assert f"{tmp_path}/right.yaml: projection_matrix has no baseline" in said(tmp_path, *QUICK)
    write(rows, replace(drive.geometries["right"], width=1440, height=1080))
    assert "right.yaml: is for frames of 1440x1080 pixels, right8.png has 720x540" in said(tmp_path, *QUICK)
    second = [row.replace(f",{9 / 60},", f",{8 / 60},") for row in rows[3:5]]
    for changed, words in (
        (
            [*rows[:3], *second, *rows[5:]],
            "left8.png to right9.png have one time_s",
        ),
        (rows[:-1], "has no partner"),
        ([*rows[:2], "x.png,up,1,2,3"], "line 3 needs file, side, time_s"),
        ([*rows[:2], f"{'x' * 200_000},left,1,2,3"], "is not CSV (field larger than field limit"),
        ([*rows[:2], '"' + "x\n" * 100_000 + ",left,1,2,3"], "is not CSV (field larger than field limit"),
        (["a,b", "1,2"], "must name the columns"),
    ):
        write(changed)
        assert words in said(tmp_path, *QUICK)
    smaller = cv2.imread(str(tmp_path / "right15.png"), cv2.IMREAD_UNCHANGED)[:-2]
    write(rows, encoding="utf-8-sig")  # as spreadsheets do
    (tmp_path / "left20.png").unlink()
    assert "left20.png: is no image that can be read" in said(tmp_path, *QUICK)
    for other, words in (
        (smaller, "right15.png: is 720x538 with 8 bits, right8.png is 720x540 with 8 bits"),
        (smaller.astype(np.uint16), "right15.png: is 720x538 with 16 bits"),
    ):
        cv2.imwrite(str(tmp_path / "right15.png"), other)
        assert words in said(tmp_path, *QUICK)
    (tmp_path / "frames.csv").unlink()
    assert "no drive in it: no .mcap file, and no frames.csv" in said(tmp_path, *QUICK)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    ("before", "between", "end"), [("", " ", "\n"), ("# t x\r\n", "\t", "\r\n"), ("t,x,q\n", ", ", "\n")]
)
def test_trajectories_of_other_programs_are_read(
    tmp_path: Path, encoding: str, before: str, between: str, end: str
) -> None:
    truth = true_trajectory()
    (tmp_path / "t.tum").write_text(tum(truth))
    text = before + tum(truth).replace(" ", between).replace("\n", end)
    (tmp_path / "other.tum").write_bytes(text.encode(encoding))
    assert np.array_equal(read_tum(tmp_path / "other.tum").poses, read_tum(tmp_path / "t.tum").poses)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"1403636579763555584,0,0,0,1,0,0,0\n", "nanoseconds as in EuRoC's files"),
        (b"1 0 0 0 0 0 0 1\n2 x 0 0 0 0 0 1\n", "line 2 is not `time x y z qx qy qz qw`"),
        (b"\xef\xbb\xbf\n# nothing\n", "fewer than two poses"),
        (b"\x89PNG\r\n", "is not text"),
    ],
)
def test_what_is_no_trajectory_is_refused_by_line(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "t.tum").write_bytes(content)
    with pytest.raises(ConfigurationError, match=words):
        read_tum(tmp_path / "t.tum")


def test_trajectories_are_written_read_and_compared(tmp_path: Path) -> None:
    truth = true_trajectory()
    (tmp_path / "t.tum").write_text("# a comment\n" + tum(truth))
    again = read_tum(tmp_path / "t.tum")
    assert np.allclose(again.poses, truth.poses, atol=1e-6)
    moved = np.linalg.inv(truth.poses[0]) @ truth.poses
    reference = ReferenceTrajectory.of(truth, 1 / 15)
    assert reference.length_m == 0.02
    assert max(reference.errors_mm(Trajectory(truth.times_s, moved))) < 1e-6
    scaled = moved.copy()
    scaled[:, :3, 3] *= 1.1
    assert np.mean(reference.errors_mm(Trajectory(truth.times_s, scaled))) == pytest.approx(2.0, rel=0.2)
    between = (truth.times_s[0] + truth.times_s[1]) / 2
    assert np.allclose(truth.at(between), (truth.poses[0] + truth.poses[1]) / 2, atol=1e-5)
    assert truth.at(0.0) is None
