"""What a release says of itself: version, maintainer and home page; and what `make release` wants before it builds.

Nothing is built here; programs that only leave files stand for those that build.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest

from tests import REPOSITORY
from tools.check_wheels import check
from tools.stage_package import PACKAGES, stage
from tools.stage_ros import stage as stage_ros

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

VERSION = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["version"]
URL = "https://example.org/autoexpose?a&b"
MAKER = {"DEBFULLNAME": "Ada & 'Bo' O\"Neil", "DEBEMAIL": "ada@example.org"}

OF_OURS = re.compile(r"\b(?:autoexpose|camera)[_-]?(?:daemon|client|lab|twin|ros)?[-_: ](\d+\.\d+\.\d+)(?!\d)")
"""A version behind a name of ours, as in names of files, tags of images, and what programs print."""
NEWER = [*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md"), *(REPOSITORY / "packages").rglob("*.md")]


def texts() -> Iterator[tuple[Path, str]]:
    """Pages, the list of their commands and tests; not the changelog, which tells of earlier versions."""
    for path in [*NEWER, *(REPOSITORY / "tests").rglob("*.yaml"), *(REPOSITORY / "tests").rglob("*.py")]:
        if path.name != "CHANGELOG.md":
            yield path, path.read_text(encoding="utf-8")


def test_pages_and_tests_name_the_version() -> None:
    found = [(path.name, version) for path, text in texts() for version in OF_OURS.findall(text)]
    assert {name for name, _ in found} >= {"packages.md", "service.md", "command_lines.yaml"}
    assert [(name, version) for name, version in found if version != VERSION] == []


def test_the_packages_for_ros_have_the_version() -> None:
    manifests = [*(REPOSITORY / "ros").glob("*/package.xml")]
    assert len(manifests) == 2
    assert {ElementTree.parse(manifest).findtext("version") for manifest in manifests} == {VERSION}
    setup = (REPOSITORY / "ros/autoexpose_ros/setup.py").read_text()
    assert re.findall(r'version="(.+)"', setup) == [VERSION]


def projects(folder: Path) -> Iterator[dict[str, Any]]:
    for name in PACKAGES:
        stage(name, folder / name)
        yield tomllib.loads((folder / name / "pyproject.toml").read_text())["project"]


def test_the_packages_say_the_same_of_us(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("URL", URL)
    for project in projects(tmp_path):
        assert project["version"] == VERSION
        assert project["authors"] == [{"name": "The autoexpose-daemon authors"}]
        assert project["license"] == "MIT"
        assert project["requires-python"] == ">=3.10"
        assert project["urls"] == {"Homepage": URL}
        assert "robotics" in project["keywords"] or project["name"] == "camera-twin"
        pythons = {each for each in project["classifiers"] if ":: Python :: 3." in each}
        assert pythons == {f"Programming Language :: Python :: 3.{minor}" for minor in (10, 11, 12, 13)}
        is_typed = [*(tmp_path / project["name"]).glob("*/py.typed")] != []
        assert ("Typing :: Typed" in project["classifiers"]) == is_typed


def test_without_a_home_page_the_packages_name_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("URL", raising=False)
    stage("camera-twin", tmp_path / "camera-twin")
    assert "urls" not in (tmp_path / "camera-twin/pyproject.toml").read_text()
    monkeypatch.setenv("URL", 'example.org"')
    with pytest.raises(SystemExit, match=r"example\.org.*URL=https://"):
        stage("camera-twin", tmp_path / "camera-twin")


def test_the_packages_for_ros_get_their_maintainer_and_home_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(REPOSITORY)
    stage_ros(f"{MAKER['DEBFULLNAME']} <{MAKER['DEBEMAIL']}>", URL, tmp_path / "ros")
    assert sorted(path.parent.name for path in tmp_path.glob("ros/*/LICENSE")) == ["autoexpose_msgs", "autoexpose_ros"]
    for manifest in tmp_path.glob("ros/*/package.xml"):
        (maintainer,) = ElementTree.parse(manifest).iter("maintainer")
        assert (maintainer.text, maintainer.get("email")) == (MAKER["DEBFULLNAME"], MAKER["DEBEMAIL"])
        assert ElementTree.parse(manifest).findtext("url") == URL
    assert f"maintainer={MAKER['DEBFULLNAME']!r}," in (tmp_path / "ros/autoexpose_ros/setup.py").read_text()
    assert not any(".invalid" in path.read_text() for path in tmp_path.rglob("*.*") if path.is_file())


def control_of(tmp_path: Path, **environment: str) -> str:
    """What a package of Debian says of itself."""
    (tmp_path / "tree/etc/autoexpose").mkdir(parents=True)
    (tmp_path / "tree/etc/autoexpose/config.yaml").touch()
    without = {name: value for name, value in os.environ.items() if name not in {*MAKER, "URL"}}
    no_git = {"GIT_CONFIG_GLOBAL": "/dev/null", "GIT_CONFIG_SYSTEM": "/dev/null", "GIT_DIR": "/nowhere"}
    make = [REPOSITORY / "tools/make-deb", tmp_path / "tree", tmp_path]
    subprocess.run(make, env=without | no_git | environment, capture_output=True, check=True)
    (package,) = tmp_path.glob("*.deb")
    return subprocess.run(["dpkg-deb", "--field", package], capture_output=True, text=True, check=True).stdout


def test_debians_package_says_who_made_it_and_where_its_home_is(tmp_path: Path) -> None:
    control = control_of(tmp_path, URL=URL, **MAKER)
    assert f"\nMaintainer: {MAKER['DEBFULLNAME']} <{MAKER['DEBEMAIL']}>\n" in control
    assert f"\nHomepage: {URL}\n" in control
    assert f"\nVersion: {VERSION}\n" in control


def test_debians_package_can_be_made_by_nobody_in_particular(tmp_path: Path) -> None:
    control = control_of(tmp_path)
    assert re.search(r"\nMaintainer: autoexpose-daemon <root@\S+>\n", control)
    assert "Homepage" not in control


def wheel(folder: Path, name: str, **contents: str) -> Path:
    folder.mkdir(exist_ok=True)
    with ZipFile(folder / name, "w") as zipped:
        for file, text in contents.items():
            zipped.writestr({"metadata": "a.dist-info/METADATA", "shim": "a/shim.so"}.get(file, f"a/{file}.py"), text)
    return folder / name


def test_wheels_for_other_processors_must_be_of_the_same_sources(tmp_path: Path) -> None:
    wheel(tmp_path / "ours", "a-1.0.0-x86_64.whl", code="1", shim="x86", metadata="Metadata-Version: 2.4\nName: a")
    for name, contents in {"same": {"code": "1"}, "other": {"code": "2"}, "more": {"code": "1", "new": ""}}.items():
        metadata = "Metadata-Version: 2.5\nName: a"
        other = wheel(tmp_path / name, "a-1.0.0-aarch64.whl", shim="arm", metadata=metadata, **contents)
        if name == "same":
            check(tmp_path / "ours", other)
        else:
            with pytest.raises(SystemExit, match=rf"aarch64.*other sources.*{'code' if name == 'other' else 'new'}"):
                check(tmp_path / "ours", other)
    with pytest.raises(SystemExit, match=r"has no wheel of a 1\.0\.1"):
        check(tmp_path / "ours", wheel(tmp_path / "later", "a-1.0.1-aarch64.whl"))


STAND_INS = {
    "bin/make": """\
        case $* in
            *wheels*) dist=${!#}; dist=${dist#DIST=}; mkdir -p "$dist"; touch "$dist/camera_twin-$version.whl" ;;
            *deb*) mkdir -p build/deb; touch build/deb/autoexpose.deb ;;
            *docs*) mkdir -p build/site; touch build/site/index.html ;;
        esac""",
    "tests/platforms/install-wheels": 'cd /; mkdir "$2"',
    "tools/install-debian": "",
    "bin/sudo": 'exec "$@"',
    "tools/make-image": """\
        mkdir build/image
        touch build/image/autoexpose-$version-$(dpkg --print-architecture).tar
        [ -z "$BROKEN" ]""",
}


class Checkout:
    """A repository with a changelog, and programs that stand for those that build."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for place in ("tools", "ros"):
            shutil.copytree(REPOSITORY / place, folder / place, ignore=shutil.ignore_patterns("__pycache__"))
        for file in ("pyproject.toml", "LICENSE", ".gitignore"):
            shutil.copy(REPOSITORY / file, folder)
        for file, commands in STAND_INS.items():
            script = folder / file
            script.parent.mkdir(parents=True, exist_ok=True)
            script.write_text(f"#!/bin/bash\nset -eu\n{commands}\n")
            script.chmod(0o755)
        self.write(f"# Changelog\n\n## {VERSION}\n\nAll is new.\n\n## 0.9.0\n\nOld.\n")

    def write(self, changelog: str) -> None:
        (self.folder / "CHANGELOG.md").write_text(changelog)
        self.git("init", "--quiet")
        self.git("add", ".")
        self.git("commit", "--quiet", "--allow-empty", "-m", "all")

    def git(self, *arguments: str) -> None:
        identity = ["-c", "user.name=A", "-c", "user.email=a@example.org"]
        subprocess.run(["git", *identity, *arguments], cwd=self.folder, check=True)

    def release(self, **environment: str) -> tuple[int, str]:
        path = f"{self.folder}/bin:{os.environ['PATH']}"
        ours = {"PATH": path, "URL": URL, **MAKER, "BROKEN": "", "GIT_CONFIG_GLOBAL": "/dev/null"}
        command = [self.folder / "tools/make-release"]
        said = subprocess.run(command, env=os.environ | ours | environment, capture_output=True, text=True, check=False)
        return said.returncode, said.stdout + said.stderr


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path / "checkout")


def refused(checkout: Checkout, *facts: str, **environment: str) -> None:
    status, said = checkout.release(**environment)
    assert status == 1
    assert said.count("\n") == 1
    assert all(fact in said for fact in facts), said
    assert not (checkout.folder / "build").exists()


def test_changes_that_are_not_committed_stop_it(checkout: Checkout) -> None:
    (checkout.folder / "LICENSE").write_text("other")
    refused(checkout, "LICENSE", "commit")


def test_a_tag_that_exists_stops_it(checkout: Checkout) -> None:
    checkout.git("tag", f"v{VERSION}")
    refused(checkout, f"v{VERSION}", "pyproject.toml")


@pytest.mark.parametrize("section", ["", f"## {VERSION}\n", f"## {VERSION}1\n\nNew.\n", f"### {VERSION}\n\nNew.\n"])
def test_a_version_without_a_word_of_what_is_new_stops_it(checkout: Checkout, section: str) -> None:
    checkout.write(f"# Changelog\n\n{section}\n## 0.9.0\n\nOld.\n")
    refused(checkout, "CHANGELOG.md", f"## {VERSION}")


def test_it_says_what_to_give(checkout: Checkout) -> None:
    refused(checkout, "DEBFULLNAME", "DEBEMAIL", "git", "URL=https://", URL="", DEBFULLNAME="", DEBEMAIL="")
    refused(checkout, "URL=https://", URL="example.org")


def test_all_is_laid_into_one_folder_with_sums_and_notes(checkout: Checkout) -> None:
    status, said = checkout.release()
    assert status == 0, said
    folder = checkout.folder / f"build/release/autoexpose-daemon-{VERSION}"
    assert (folder / "release-notes.md").read_text() == "All is new.\n"
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert {re.sub(r"^.*\.", "", file) for file in files - {"SHA256SUMS"}} == {"whl", "deb", "gz", "tar", "md"}
    summed = {line.split(maxsplit=1)[1] for line in (folder / "SHA256SUMS").read_text().splitlines()}
    assert summed == files - {"SHA256SUMS"}
    for advice in ("make test-arm64", "make test-platforms SUITES=jammy", f"v{VERSION}", "twine upload", "missing"):
        assert advice in said
    ros = subprocess.run(["tar", "-tf", folder / f"autoexpose-ros-{VERSION}.tar.gz"], capture_output=True, check=True)
    assert f"autoexpose-ros-{VERSION}/autoexpose_ros/package.xml".encode() in ros.stdout


def test_after_a_failure_only_the_rest_is_done(checkout: Checkout) -> None:
    status, said = checkout.release(BROKEN="1")
    assert status == 1
    assert "image" in said.splitlines()[-2] + said.splitlines()[-1]
    shutil.rmtree(checkout.folder / "build/image")
    status, said = checkout.release()
    assert status == 0, said
    assert said.count("done before") == 5
    checkout.write(f"# Changelog\n\n## {VERSION}\n\nOther words.\n")
    shutil.rmtree(checkout.folder / "build/image")
    assert "done before" not in checkout.release()[1]
