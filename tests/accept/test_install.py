"""What `make install` and `make deb` put on a robot; DESTDIR stands for the robot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import REPOSITORY
from tests.accept.commands import output
from tests.calibration.sweeps import MadeUpCamera
from tests.calibration.test_commands import write_images
from tests.systemd.test_install import FILES, OF_THE_PROGRAM

CONFIG = "cameras: {left: {serial: MINE}}\n"

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A robot whose configuration was there before; the product is uninstalled from it in the end."""
    robot = tmp_path_factory.mktemp("robot")
    config = robot / "etc/autoexpose/config.yaml"
    config.parent.mkdir(parents=True)
    config.write_text(CONFIG)
    output("make", "install", f"DESTDIR={robot}")
    yield robot
    output("make", "uninstall", f"DESTDIR={robot}")
    assert [path for path in robot.rglob("*") if path.is_file() and "DEBIAN" not in path.parts] == [config]


def autoexpose(robot: Path, *arguments: str | Path) -> str:
    return output(robot / "opt/autoexpose/bin/python", robot / "opt/autoexpose/bin/autoexpose", *arguments)


def test_the_installed_program_runs_and_keeps_the_configuration(robot: Path) -> None:
    assert "machine-vision cameras" in autoexpose(robot, "--help")
    assert "valid: left MINE" in autoexpose(robot, "config", "check", robot / "etc/autoexpose/config.yaml")


def test_the_page_is_there_but_not_enabled(robot: Path) -> None:
    assert "live page" in autoexpose(robot, "page", "--help")
    (static,) = robot.glob("opt/autoexpose/lib/python3*/site-packages/autoexpose_daemon/page/static")
    ours = REPOSITORY / "autoexpose_daemon/page/static"
    assert {file.name for file in static.iterdir()} == {file.name for file in ours.iterdir()}
    assert not list(robot.glob("etc/systemd/system/*.wants"))


def test_units_rules_and_documentation_are_in_place(robot: Path) -> None:
    link = robot / "usr/local/bin/autoexpose"
    assert [file for file in FILES | OF_THE_PROGRAM if not (robot / file).is_file() and robot / file != link] == []
    assert str(link.readlink()) == "/opt/autoexpose/bin/autoexpose"


def test_the_tree_does_not_remember_where_it_was_made(robot: Path) -> None:
    places = (str(robot).encode(), str(REPOSITORY).encode())
    files = [path for path in robot.rglob("*") if path.is_file()]
    packages = [path for path in files if "autoexpose_daemon" in str(path) or path.parent.name == "bin"]
    assert packages
    assert [path for path in packages if any(place in path.read_bytes() for place in places)] == []


def test_nothing_but_aravis_comes_from_debians_python_packages(robot: Path) -> None:
    packages = {path.name for path in robot.glob("opt/autoexpose/lib/python3*/site-packages/*")}
    assert {"numpy", "cv2", "yaml", "pydantic", "typer", "rich", "usb", "jinja2", "matplotlib", "starlette"} <= packages


def test_a_camera_is_calibrated_and_gets_its_report(robot: Path, tmp_path: Path) -> None:
    images = write_images(tmp_path / "shots", MadeUpCamera(), [100.0 * 2**n for n in range(11)])
    file = tmp_path / "camera.response.yaml"
    assert "verdict: believe it" in autoexpose(robot, "calibrate", "response", "--images", images, "-o", file)
    assert "data:image/png" in file.with_suffix(".html").read_text(encoding="utf-8")


def test_it_has_only_what_a_robot_runs(robot: Path) -> None:
    assert sum(path.lstat().st_blocks * 512 for path in robot.rglob("*")) < 350 << 20
    programs = {path.name for path in robot.glob("opt/autoexpose/bin/*") if not path.name.startswith("python")}
    assert programs == {"autoexpose"}
    packages = {path.name for path in robot.glob("opt/autoexpose/lib/python3*/site-packages/*")}
    assert not packages & {"pip", "setuptools", "scipy", "pandas", "evo", "numba", "autoexpose_lab"}


def test_every_compiled_library_still_loads(robot: Path) -> None:
    libraries = [path for path in robot.rglob("*.so*") if path.is_file()]
    assert len(libraries) > 50
    for library in libraries:
        output("ldd", library)
    imports = "import numpy.linalg, cv2, zenoh, matplotlib.figure"
    output(robot / "opt/autoexpose/bin/python", "-c", imports)


def test_the_debian_package_holds_the_tree(robot: Path, tmp_path: Path) -> None:
    output("tools/make-deb", robot, tmp_path)
    (package,) = tmp_path.glob("autoexpose-daemon_*.deb")
    control = output("dpkg-deb", "--info", package)
    assert "Package: autoexpose-daemon" in control
    for dependency in ("gir1.2-aravis-0.8", "python3-gi", "python3 (>= 3."):
        assert dependency in control
    contents = output("dpkg-deb", "--contents", package)
    for file in (*FILES, "opt/autoexpose/bin/autoexpose", "etc/autoexpose/config.yaml"):
        assert f" ./{file}\n" in contents
    assert all(line.split()[1] == "root/root" for line in contents.splitlines())
    assert "conffiles" in control
