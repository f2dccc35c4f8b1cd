"""What would be installed, without installing it: our own wheel, and the files beside it.

`tests/accept/test_install.py` installs everything.
"""

from __future__ import annotations

import configparser
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from zipfile import ZipFile

import pytest

from autoexpose_daemon.cli.listing import LISTINGS
from tests import REPOSITORY
from tools.stage_package import stage

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

INSTALL_TREE = REPOSITORY / "tools/install-tree"
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
PACKAGES: list[str] = PROJECT["tool"]["importlinter"]["root_packages"]
LAB = {"evaluation", "navigation"}
NOT_SHIPPED = {".c", ".h", ".so"}
"""The sources of the C parts, which may be shipped, and what is built on each machine."""

CONFIG = "etc/autoexpose/config.yaml"
FILES = {
    "etc/systemd/system/autoexpose.service",
    "etc/systemd/system/autoexpose-page.service",
    "etc/sysusers.d/autoexpose.conf",
    "etc/tmpfiles.d/autoexpose-usbfs-memory.conf",
    "etc/udev/rules.d/60-usb3-vision.rules",
    "usr/local/share/doc/autoexpose-daemon/docs/do/service.md",
}
"""Of `make install`."""
OF_THE_PROGRAM = {
    "opt/autoexpose/bin/autoexpose",
    "usr/local/bin/autoexpose",
    "usr/local/share/man/man1/autoexpose.1",
    "usr/local/share/man/man1/autoexpose-run.1",
    "usr/local/share/bash-completion/completions/autoexpose",
    "usr/local/share/fish/vendor_completions.d/autoexpose.fish",
    "usr/local/share/zsh/site-functions/_autoexpose",
}


def output(*command: str | Path, **variables: str) -> str:
    result = subprocess.run(
        command, cwd=REPOSITORY, env=os.environ | variables, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def installed_beside(prefix: str = "usr/local") -> dict[str, str]:
    """Files in the checkout by where `tools/install-tree` puts them, as bash reads its list."""
    (listing,) = re.findall(r"^system=.*?^done$", INSTALL_TREE.read_text(), re.DOTALL | re.MULTILINE)
    words = output("bash", "-uc", f'prefix={prefix}\n{listing}\nprintf "%s\\n" "${{files[@]}}"').splitlines()
    return dict(zip(words[1::2], words[::2], strict=True))


def wheel_of(package: str, folder: Path) -> ZipFile:
    """Without its C parts, which take long to compile."""
    source = folder / package
    stage(package, source)
    build = (
        "import functools, os, sys, setuptools; os.chdir(sys.argv[1]);"
        "setuptools.Extension = functools.partial(setuptools.Extension, optional=True);"
        "from setuptools import build_meta; build_meta.build_wheel('.')"
    )
    output(sys.executable, "-c", build, source, CC="false")
    (file,) = source.glob("*.whl")
    return ZipFile(file)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> ZipFile:
    """As `tools/install-tree` makes it."""
    return wheel_of("autoexpose-daemon", tmp_path_factory.mktemp("source"))


@pytest.fixture(scope="module")
def wheel_of_the_lab(tmp_path_factory: pytest.TempPathFactory) -> ZipFile:
    return wheel_of("autoexpose-lab", tmp_path_factory.mktemp("source"))


def held(wheel: ZipFile) -> set[str]:
    """Its files, but for those about it and the C parts."""
    names = (name for name in wheel.namelist() if ".dist-info/" not in name)
    return {name for name in names if Path(name).suffix not in NOT_SHIPPED}


def files_below(top: str, rooms: Iterable[str]) -> set[str]:
    """Where the files of our rooms are in a package with this name."""
    files = [file for room in rooms for file in (REPOSITORY / room).rglob("*") if file.is_file()]
    shipped = (file for file in files if file.suffix not in NOT_SHIPPED and file.parent.name != "__pycache__")
    places = (file.relative_to(REPOSITORY) for file in shipped)
    return {(place if place.parts[0] == top else Path(top, place)).as_posix() for place in places}


def test_the_wheel_holds_every_file_of_our_packages_but_the_lab_and_nothing_else(wheel: ZipFile) -> None:
    top = "autoexpose_daemon"
    ours = files_below(top, {*PACKAGES} - LAB)
    assert {f"{top}/page/static/page.js", f"{top}/calibration/report/report.html", f"{top}/drivers/py.typed"} < ours
    assert f"{top}/control/policies/learned/zhang2024.npz" in ours
    assert held(wheel) == ours


def test_the_wheel_of_the_lab_holds_the_rest(wheel_of_the_lab: ZipFile) -> None:
    assert held(wheel_of_the_lab) == files_below("autoexpose_lab", LAB) | {"autoexpose_lab/__init__.py"}


def entry_points(wheel: ZipFile) -> configparser.ConfigParser:
    (listing,) = (name for name in wheel.namelist() if name.endswith(".dist-info/entry_points.txt"))
    points = configparser.ConfigParser()
    points.read_string(wheel.read(listing).decode())
    return points


def test_the_wheels_have_our_commands(wheel: ZipFile, wheel_of_the_lab: ZipFile) -> None:
    of_daemon, of_lab = entry_points(wheel), entry_points(wheel_of_the_lab)
    assert of_daemon.sections() == ["console_scripts"]
    assert of_daemon["console_scripts"]["autoexpose"] == "autoexpose_daemon.cli:main"
    assert {*of_lab["autoexpose.commands"]} == {name for name, listing in LISTINGS.items() if not listing.place}
    assert of_lab["autoexpose.commands"]["arena"] == "autoexpose_lab.evaluation.arena.arena_app:arena_app"


def test_units_rules_and_documentation_are_there_to_be_installed() -> None:
    listed = installed_beside()
    assert {*listed} >= FILES
    assert [file for file in listed.values() if not (REPOSITORY / file).is_file()] == []
    assert (REPOSITORY / "systemd/config.yaml").is_file()
    of_the_distribution = installed_beside("usr")
    assert [place for place in of_the_distribution if not place.startswith(("usr/lib/", "usr/share/"))] == []


def test_what_is_uninstalled_is_gone_except_the_configuration(tmp_path: Path) -> None:
    for file in (*installed_beside(), *OF_THE_PROGRAM, CONFIG):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    output("make", "uninstall", f"DESTDIR={tmp_path}")
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()] == [CONFIG]
