"""Packages for others: one import name each, and all that is imported is there."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import REPOSITORY
from tools.stage_package import PACKAGES, ROOMS, Rewriter, reached, stage

(VERSION,) = re.findall(r'^version = "(.+)"$', (REPOSITORY / "pyproject.toml").read_text(), re.MULTILINE)


@pytest.fixture(scope="module", params=sorted(PACKAGES))
def staged(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stage") / request.param
    stage(request.param, folder)
    return folder


def modules_of(folder: Path) -> set[str]:
    """The modules and packages that are laid out in a folder."""
    names = (".".join(file.relative_to(folder).with_suffix("").parts) for file in folder.rglob("*.py"))
    return {name.removesuffix(".__init__") for name in names}


def test_it_has_one_import_name_and_imports_only_what_there_is(staged: Path, tmp_path: Path) -> None:
    name = staged.name.replace("-", "_")
    assert [path.name for path in staged.iterdir() if path.is_dir()] == [name]
    files, modules = {*staged.rglob("*.py")}, modules_of(staged)
    if PACKAGES[staged.name].beside:
        stage("autoexpose-daemon", tmp_path / "beside")
        modules |= modules_of(tmp_path / "beside")
    assert len(files) > 30
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in {name, *ROOMS}:
                assert node.module in modules, f"{file}: {node.module}"


def test_it_can_be_imported_and_brings_no_room_along(staged: Path) -> None:
    name = staged.name.replace("-", "_")
    face = {"autoexpose-daemon": "autoexpose_daemon.cli"}.get(staged.name, name)
    others = sorted({*ROOMS} - {name})
    program = f"""
import sys, {face}
assert {name}.__file__.startswith({str(staged)!r})
print([room for room in {others} if room in sys.modules])
"""
    said = subprocess.run([sys.executable, "-c", program], cwd=staged, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    assert said.stdout == "[]\n"


def test_names_are_changed_where_they_are_modules_and_nowhere_else() -> None:
    rewrite = Rewriter({"fake_camera": "camera_twin", "drivers": "camera_twin.drivers"})
    text = """
from drivers.errors import A
    from drivers import frames
from fake_camera.usb3.run import (
    drivers = ["drivers", "fake_camera", 'fake_camera.usb3._shim', "-m", "fake_camera"]
points = "fake_camera.a:main", "fake_camera/usb3/shim"  # from drivers, `python -m fake_camera --help`
"""
    assert (
        rewrite(text)
        == """
from camera_twin.drivers.errors import A
    from camera_twin.drivers import frames
from camera_twin.usb3.run import (
    drivers = ["drivers", "fake_camera", 'camera_twin.usb3._shim', "-m", "camera_twin"]
points = "camera_twin.a:main", "camera_twin/usb3/shim"  # from drivers, `python -m camera_twin --help`
"""
    )


def test_the_daemon_has_nothing_of_the_lab_and_only_the_lab_has_entry_points(tmp_path: Path) -> None:
    for name in PACKAGES:
        stage(name, tmp_path / name)
        project = (tmp_path / name / "pyproject.toml").read_text(encoding="utf-8")
        assert ('project.entry-points."autoexpose.commands' in project) == (name == "autoexpose-lab")
        assert f'version = "{VERSION}"' in project
    daemon = tmp_path / "autoexpose-daemon/autoexpose_daemon"
    assert not {"evaluation", "navigation"} & {path.name for path in daemon.iterdir()}
    lab = tmp_path / "autoexpose-lab"
    assert f']=={VERSION}"' in (lab / "pyproject.toml").read_text(encoding="utf-8")
    assert {path.name for path in (lab / "autoexpose_lab").iterdir() if path.is_dir()} == {"evaluation", "navigation"}


def test_the_client_has_only_what_frames_need() -> None:
    modules = reached(PACKAGES["autoexpose-client"].face)
    assert "autoexpose_daemon.messages.frames" in modules
    assert not any(module.startswith(("autoexpose_daemon.runtime", "autoexpose_daemon.config")) for module in modules)
