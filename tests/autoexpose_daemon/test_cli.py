"""The command line as a user meets it: processes, exit codes, what they print, and that listing commands loads none."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import typer
import yaml

import autoexpose_daemon
from autoexpose_daemon.cli import whole_command_line
from autoexpose_daemon.cli.daemon import _explaining, stop_on_signals
from autoexpose_daemon.cli.listing import LISTINGS
from autoexpose_daemon.service.notify import Notifier
from calibration.document import CameraIdentity
from calibration.response.file import Origin, ResponseFile
from imaging.errors import AutoexposeError, ConfigurationError, NodeError, UnsupportedCameraError
from imaging.geometry import SIDES
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE, PATIENCE_S, Within, autoexpose
from tests.autoexpose_daemon.stereo import stereo_cameras
from tests.calibration.geometry.written import small_ros
from tests.fake_camera.gige.gige_client import CCP, GvcpClient
from tests.fakes import FOREIGN_ADDRESS, fake_camera, foreign_camera, loopback_address


def test_config_check_says_what_a_good_file_holds(within: Within, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text("cameras: {left: {serial: A}, right: {serial: B}}")
    code, output, _ = within("config", "check", str(file))
    assert code == 0
    assert "left A, right B" in output


@pytest.mark.parametrize("command", ["config check", "config show", "run", "record new.mcap", "doctor"])
def test_a_configuration_is_an_argument_or_an_option(within: Within, tmp_path: Path, command: str) -> None:
    file = str(tmp_path / "missing.yaml")
    for given in ([file], ["-c", file], ["--config", file]):
        _, _, told = within(*command.split(), *given)
        assert f"{file}: cannot be read" in told
    assert "give one configuration file" in within(*command.split(), file, "-c", file)[2]


def test_config_check_names_a_baseline_that_few_rigs_have(within: Within, tmp_path: Path) -> None:
    for camera in SIDES:
        document = small_ros(camera, 720, 540)
        document["projection_matrix"]["data"][3] *= 100
        (tmp_path / f"{camera}.yaml").write_text(yaml.safe_dump(document))
    file = tmp_path / "rig.yaml"
    cameras = ", ".join(f"{camera}: {{serial: {camera}, calibration: {camera}.yaml}}" for camera in SIDES)
    file.write_text(f"cameras: {{{cameras}}}")
    code, output, _ = within("config", "check", str(file))
    assert code == 0
    assert "note: cameras.right.calibration: the baseline is 8 m" in output


def test_a_policy_that_does_not_exist_is_named_with_a_near_one(within: Within) -> None:
    assert "'begin2021'; did you mean begin2022?" in within.refused("demo", "--policy", "begin2021")


def test_top_without_a_daemon_is_one_sentence_that_says_what_is_needed(
    within: Within, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = f"tcp/{loopback_address()}:7448"
    monkeypatch.setattr("autoexpose_daemon.client.top._PATIENCE_S", 0.1)
    told = within.refused("top", "--once", "--connect", at)
    assert f"no answer from {at}" in told and "`publish: {}`" in told


def test_top_of_all_rigs_is_checked_before_it_looks_for_them(
    within: Within, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("autoexpose_daemon.client.top._PATIENCE_S", 0.1)
    at, missing = f"tcp/{loopback_address()}:7448", tmp_path / "zenoh.json5"
    refusals = {
        ("--rig", "scout"): "--all shows every rig: leave out --all or --rig scout",
        ("--connect", "nowhere"): "nowhere is not an endpoint",
        ("--zenoh", str(missing)): f"{missing} cannot be read (No such file or directory): name a zenoh",
        ("--connect", at): f"no answer from {at}: is a daemon with `publish`, or a router, listening there?",
    }
    for options, refusal in refusals.items():
        assert within.refused("top", "--all", "--once", *options).startswith(f"autoexpose: {refusal}")


@pytest.mark.wire
def test_list_shows_a_camera_with_its_serial() -> None:
    with fake_camera() as camera:
        result, as_json = autoexpose("list"), autoexpose("list", "--json")
    assert result.returncode == as_json.returncode == 0
    head, *lines = result.stdout.splitlines()
    (line,) = (line for line in lines if camera.serial in line)
    for name, value in (("serial", camera.serial), ("model", "FakeGV287M"), ("address", camera.address)):
        assert line[head.index(name) :].startswith(value)
    (found,) = (each for each in json.loads(as_json.stdout)["cameras"] if each["serial"] == camera.serial)
    assert (found["address"], found["transport"]) == (camera.address, "gige")


@pytest.mark.wire
def test_run_stops_on_sigterm_and_leaves_the_cameras_free(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    with stereo_cameras() as (left, right, _):
        file.write_text(f"cameras: {{left: {{serial: {left.serial}}}, right: {{serial: {right.serial}}}}}")
        with subprocess.Popen([*AUTOEXPOSE, "run", str(file)], stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            lines = iter(process.stderr.readline, "")
            ready = list(itertools.islice((line for line in lines if line.endswith("ready\n")), 2))
            process.send_signal(signal.SIGTERM)
            _, rest = process.communicate(timeout=30)
        assert len(ready) == 2
        assert process.returncode == 0, rest
        assert "stopped:" in rest
        for camera in (left, right):
            with GvcpClient(camera.address) as client:
                assert client.read(CCP) == 0


@pytest.mark.wire
def test_run_refuses_a_response_file_for_another_pixel_format(tmp_path: Path) -> None:
    file, response = tmp_path / "rig.yaml", tmp_path / "left.response.yaml"
    with fake_camera() as camera:
        file.write_text(f"cameras: {{left: {{serial: {camera.serial}, response: {response.name}}}}}")
        identity = CameraIdentity("Autoexpose", "FakeGV287M", camera.serial)
        ResponseFile(ResponseFunction.linear(), Origin(identity, PixelFormat.MONO12)).save(response)
        result = autoexpose("run", "-c", str(file))
    assert result.returncode == os.EX_CONFIG
    sentence = f"autoexpose: {response}: pixel_format is Mono12, but camera {camera.serial} runs with Mono8: set "
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("kind", [ConfigurationError, UnsupportedCameraError, NodeError])
def test_what_stays_is_not_worth_another_start(kind: type[AutoexposeError], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as ended, _explaining(Notifier(None)):
        raise kind("camera S: it has no PixelFormat")
    assert ended.value.exit_code == os.EX_CONFIG
    assert capsys.readouterr().err.endswith("camera S: it has no PixelFormat\n")


def exposure_of_foreign_camera() -> int:
    command = ["arv-tool-0.8", "-a", FOREIGN_ADDRESS, "control", "ExposureTimeAbs"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    written = re.search(r"ExposureTimeAbs = (\d+)", shown)
    assert written is not None
    return int(written[1])


@pytest.mark.wire
@pytest.mark.needs("arv-fake-gv-camera-0.8", "arv-tool-0.8")
def test_run_drives_a_camera_that_we_did_not_write(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    with foreign_camera() as serial:
        file.write_text(
            f"cameras: {{left: {{serial: {serial}}}}}\n"
            "trigger: {mode: free_run, rate_hz: 25}\n"
            "control: {policy: neves2009, start: {exposure_time_us: 300}}"
        )
        with subprocess.Popen([*AUTOEXPOSE, "run", "-c", str(file)], stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            told = list(itertools.takewhile(lambda line: "exposing" not in line, iter(process.stderr.readline, "")))
            deadline_s = time.monotonic() + PATIENCE_S
            while exposure_of_foreign_camera() == 300:
                assert time.monotonic() < deadline_s
            process.send_signal(signal.SIGTERM)
            _, rest = process.communicate(timeout=30)
    assert process.returncode == 0, [*told, rest]
    limitations = " ".join(told)
    assert "not driven, so that dim light stays dark" in limitations
    assert "no chunk data" in limitations
    figures = re.search(r"stopped: .*?; (\d+) pairs; lost: ", rest)
    assert figures is not None, rest
    assert int(figures[1]) > 0


@pytest.mark.realtime
def test_the_demo_reports_what_happened(tmp_path: Path) -> None:
    light = tmp_path / "light.yaml"
    light.write_text("repeat_s: 3\nlight: [{at_s: 0, lux: 150}, {at_s: 1.5, lux: 1}]")
    summary, plot = tmp_path / "out.json", tmp_path / "out.png"
    started_s = time.monotonic()
    options = f"--seconds 5 --policy neves2009 --light {light} --summary {summary} --plot {plot}"
    result = autoexpose("demo", *options.split())
    assert result.returncode == 0, result.stderr
    assert time.monotonic() - started_s < 60
    figures = json.loads(summary.read_text())
    assert (figures["transport"], figures["policy"]) == ("gige", "neves2009")
    assert figures["triggers"] == figures["pairs"] + sum(figures["lost"].values())
    # On a machine that is busy with other work the fake cameras are late, and that is known.
    assert figures["pairs"] + figures["fakes"]["overruns"] > figures["triggers"] / 2
    assert figures["rate_hz"] in (60, 30, 20)
    assert figures["fakes"]["overruns"] >= 0
    assert len(figures["fakes"]["cpu_percent"]) == 2
    assert all(percent > 0 for percent in figures["fakes"]["cpu_percent"])
    assert {setting["lux"] for setting in figures["settings"]} == {150, 1}
    assert figures["lost"].get("startup", 0) <= 120
    assert figures["reference_step_ms"] > 0
    assert figures["daemon_cpu_percent"] > 0
    for part in ("pairing_ms", "decision_ms", "held_ms", "write_ms", "frame_to_node_ms"):
        assert figures[part]["p50"] <= figures[part]["p99"]
    assert figures["steps"]
    assert plot.read_bytes().startswith(b"\x89PNG")
    settled = [step["frames_to_settle"] is not None for step in figures["steps"]]
    assert any(settled)  # that each step settles takes the minute of `make accept`


def test_a_signal_may_come_while_its_event_is_locked() -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    stop = threading.Event()
    try:
        stop_on_signals(stop)
        with stop._cond:  # as within its wait()
            signal.raise_signal(signal.SIGTERM)
        assert stop.wait(10)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


HEAVY = ("numpy", "cv2", "scipy", "matplotlib", "pydantic", "yaml", "importlib.metadata")
PROGRAM = f"""
import atexit, sys
atexit.register(lambda: print("heavy:", *[name for name in {HEAVY} if name in sys.modules]))
sys.argv[0] = "autoexpose"
from autoexpose_daemon.cli import main
main()
"""
LAB = sorted(name for name, listing in LISTINGS.items() if not listing.place)


def said(*arguments: str, **environment: str) -> list[str]:
    """Lines of stdout; of a process, as this one has loaded everything."""
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments],
        env=os.environ | {"COLUMNS": "80"} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stderr == ""
    return result.stdout.splitlines()


def test_the_help_has_a_line_for_each_command_and_loads_none() -> None:
    *lines, heavy = said("--help")
    assert heavy == "heavy:"
    for name, listing in LISTINGS.items():
        assert [line.strip("│ ").split("  ", 1)[1].strip() for line in lines if line.startswith(f"│ {name} ")] == [
            listing.summary
        ]


@pytest.mark.parametrize("words", ["", "a"])
def test_a_shell_completes_names_and_loads_none(words: str) -> None:
    *names, heavy = said(_AUTOEXPOSE_COMPLETE="complete_bash", COMP_WORDS=f"autoexpose {words}", COMP_CWORD="1")
    assert heavy == "heavy:"
    assert names == [name for name in LISTINGS if name.startswith(words)]


def test_a_shell_completes_the_options_of_a_command() -> None:
    *options, _ = said(_AUTOEXPOSE_COMPLETE="complete_bash", COMP_WORDS="autoexpose record --", COMP_CWORD="2")
    assert {"--config", "--bracket", "--keep", "--help"} <= {*options}


def test_every_command_can_be_loaded_and_explains_itself() -> None:
    commands = whole_command_line().commands
    assert commands.keys() == LISTINGS.keys()
    assert [name for name, command in commands.items() if not command.help] == []


@pytest.fixture
def without_the_lab(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.metadata.entry_points", lambda **_: ())
    monkeypatch.setattr("autoexpose_daemon.demo.run.entry_points", lambda **_: ())


@pytest.mark.usefixtures("without_the_lab")
@pytest.mark.parametrize("words", [*([name] for name in LAB), ["map", "--help"], ["demo", "--navigate"]])
def test_without_the_lab_its_commands_say_what_to_install(within: Within, words: list[str]) -> None:
    assert "pip install autoexpose-lab" in within.refused(*words)


@pytest.mark.usefixtures("without_the_lab")
def test_without_the_lab_a_shell_completes_nothing_of_its_commands(
    monkeypatch: pytest.MonkeyPatch, within: Within
) -> None:
    for name, value in (
        ("_AUTOEXPOSE_COMPLETE", "complete_bash"),
        ("COMP_WORDS", "autoexpose map i"),
        ("COMP_CWORD", "2"),
    ):
        monkeypatch.setenv(name, value)
    assert within() == (0, "\n", "")


@pytest.mark.parametrize(("words", "extras"), [("ctl show", "publish"), ("top", "publish"), ("page", "page,publish")])
def test_an_extra_that_is_missing_is_named(
    within: Within, monkeypatch: pytest.MonkeyPatch, words: str, extras: str
) -> None:
    for module in [name for name in sys.modules if re.match(r"autoexpose_daemon\.(client|page|publish)", name)]:
        if module.count(".") == 1:  # importing a room again puts another one in its place
            monkeypatch.setattr(autoexpose_daemon, module.rpartition(".")[2], sys.modules[module])
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "zenoh", None)
    told = within.refused(*words.split())
    assert "zenoh" in told and f"'autoexpose-daemon[{extras}]'" in told
