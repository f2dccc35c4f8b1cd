"""The wheels of `make wheels`, each in an environment of its own, where no compiler is to be found."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from autoexpose_daemon.config.document import PublishConfig
from tests import REPOSITORY
from tests.accept.commands import output
from tests.autoexpose_daemon.publish.steps import endpoint, publishing
from tools.stage_package import ROOMS

pytestmark = pytest.mark.timeout(600)

TOY_DRIVER = """
import socket

def test_the_camera_answers(gige_camera):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as driver:
        driver.settimeout(2)
        driver.sendto(bytes.fromhex("4201 0002 0000 0001"), (gige_camera.address, 3956))
        assert gige_camera.serial.encode() in driver.recv(1024)
"""
RECEIVER = """
import sys
from autoexpose_client import StereoClient
with StereoClient("rig", connect=[sys.argv[1]]) as client:
    for pair in client:
        print(pair.left.pixels.shape, pair.left.setting.exposure_time_us)
        break
heavy = {"cv2", "pydantic", "usb", "yaml", "autoexpose_daemon", "drivers", "calibration", "imaging"}
print(sorted(heavy & {*sys.modules}))
"""


def run(*command: str | Path, folder: Path, status: int = 0) -> str:
    """What a command prints where there is no compiler."""
    return output(*command, folder=folder, status=status, environment={"CC": "false", "CXX": "false"})


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    output("make", "wheels", f"DIST={folder}", environment={"PYTHONDONTWRITEBYTECODE": ""})
    return folder


def installed(folder: Path, wheels: Path, *packages: str, sees_debian: bool = False) -> Path:
    """A new environment with packages of ours: names, with their extras."""
    options = ["--system-site-packages"] if sees_debian else []
    run("/usr/bin/python3", "-m", "venv", *options, folder / "venv", folder=folder)
    ours = [
        wheel_of(wheels, name) + bracket + extras for name, bracket, extras in (it.partition("[") for it in packages)
    ]
    run(folder / "venv/bin/pip", "install", "-q", *ours, "pytest", folder=folder)
    return folder / "venv"


def wheel_of(wheels: Path, package: str) -> str:
    (wheel,) = wheels.glob(f"{package}-*.whl")
    return str(wheel)


def test_every_package_has_sources_and_a_wheel_for_all_pythons(wheels: Path) -> None:
    names = sorted(re.sub(r"-\d+\.\d+\.\d+", "", file.name) for file in wheels.iterdir())
    assert [name for name in names if name.endswith(".tar.gz")] == [
        "autoexpose_client.tar.gz", "autoexpose_daemon.tar.gz", "autoexpose_lab.tar.gz", "camera_twin.tar.gz",
    ]  # fmt: skip
    client, daemon, lab, twin = (name for name in names if name.endswith(".whl"))
    assert client == "autoexpose_client-py3-none-any.whl"
    assert lab == "autoexpose_lab-py3-none-any.whl"
    assert re.fullmatch(r"autoexpose_daemon-cp3\d+-(abi3|cp3\d+)-manylinux.*\.whl", daemon)
    assert re.fullmatch(r"camera_twin-cp310-abi3-manylinux.*\.whl", twin)


def test_the_demo_runs(wheels: Path, tmp_path: Path) -> None:
    venv = installed(tmp_path, wheels, "autoexpose_daemon[sim,calibration,publish]", sees_debian=True)
    said = run(venv / "bin/autoexpose", "demo", "--seconds", "5", "--summary", "out.json", folder=tmp_path)
    assert json.loads((tmp_path / "out.json").read_text())["pairs"] > 0
    print(said)
    (packages,) = venv.glob("lib/python3*/site-packages")
    assert not {*ROOMS[1:]} & {path.name for path in packages.iterdir()}
    for command in (["calibrate", "--help"], ["fake-camera", "--help"]):
        run(venv / "bin/autoexpose", *command, folder=tmp_path)
    for command in (["arena", "--help"], ["teach"], ["demo", "--navigate"]):
        run(venv / "bin/autoexpose", *command, folder=tmp_path, status=1)


def test_the_lab_brings_its_commands_and_what_they_need(wheels: Path, tmp_path: Path) -> None:
    venv = installed(tmp_path, wheels, "autoexpose_daemon", "autoexpose_lab", sees_debian=True)
    for command in ("arena", "experiments", "rejudge", "train", "teach", "repeat", "map"):
        run(venv / "bin/autoexpose", command, "--help", folder=tmp_path)
    run(venv / "bin/autoexpose", "arena", "--quick", "--policies", "begin2022", "--json", "out.json", folder=tmp_path)
    assert json.loads((tmp_path / "out.json").read_text())


def test_the_client_receives_frames_with_little_else(wheels: Path, tmp_path: Path) -> None:
    venv, at = installed(tmp_path, wheels, "autoexpose_client"), endpoint()
    with publishing(PublishConfig(listen=(at,))):
        assert run(venv / "bin/python", "-c", RECEIVER, at, folder=tmp_path) == "(540, 720) 1000.0\n[]\n"


def test_the_twin_tests_a_toy_driver(wheels: Path, tmp_path: Path) -> None:
    venv = installed(tmp_path, wheels, "camera_twin")
    (tmp_path / "test_toy.py").write_text(TOY_DRIVER)
    assert "1 passed" in run(venv / "bin/pytest", "-q", "-p", "no:cacheprovider", "test_toy.py", folder=tmp_path)
    readme = (REPOSITORY / "packages/camera-twin/README.md").read_text()
    blocks = [block for block in re.findall(r"```python\n(.*?)```", readme, re.DOTALL) if "mycamera.xml" not in block]
    assert len(blocks) > 4
    (tmp_path / "test_readme.py").write_text("\n".join(blocks))
    assert f"{len(re.findall('def test_', ''.join(blocks)))} passed" in run(
        venv / "bin/pytest", "-q", "-p", "no:cacheprovider", "test_readme.py", folder=tmp_path
    )
