"""The package for ROS 2 workspaces has our definitions; `make accept` builds it."""

from __future__ import annotations

import re
from importlib.resources import files
from xml.etree import ElementTree

import pytest

from autoexpose_daemon import messages
from autoexpose_daemon.messages.types import TYPESTORE
from tests import REPOSITORY

PACKAGE = REPOSITORY / "ros/autoexpose_msgs"
OURS = {file.name: file.read_text() for file in files(messages).joinpath("autoexpose_msgs/msg").iterdir()}
FIELD_NAME = re.compile(r"[a-z](_?[a-z0-9])*")
"""By the rules of ROS 2: no capitals, no two underscores in a row, none at the end."""


def test_its_definitions_are_those_of_the_daemon() -> None:
    theirs = {file.name: file.read_text() for file in (PACKAGE / "msg").iterdir()}
    assert theirs == OURS, "cp autoexpose_daemon/messages/autoexpose_msgs/msg/*.msg ros/autoexpose_msgs/msg/"


def test_it_builds_all_of_them() -> None:
    built = re.findall(r"^  msg/(\w+\.msg)$", (PACKAGE / "CMakeLists.txt").read_text(), re.MULTILINE)
    assert built == sorted(OURS)


def test_it_has_the_version_of_the_daemon() -> None:
    manifest = ElementTree.parse(PACKAGE / "package.xml").getroot()
    (version,) = re.findall(r'^version = "(.+)"$', (REPOSITORY / "pyproject.toml").read_text(), re.MULTILINE)
    assert manifest.findtext("version") == version


@pytest.mark.parametrize("file", sorted(OURS))
def test_ros_accepts_the_names_of_its_fields(file: str) -> None:
    _, fields = TYPESTORE.fielddefs[f"autoexpose_msgs/msg/{file.removesuffix('.msg')}"]
    assert [name for name, _ in fields if not FIELD_NAME.fullmatch(name)] == []
