"""The launch files, as far as they can be run without ROS 2's `launch`, in whose place stand records of its calls.

Whether `ros2 launch` takes them is not shown by this.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import pytest
import yaml

from tests import REPOSITORY

PACKAGE = REPOSITORY / "ros/autoexpose_ros"
MODULES = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "ExecuteProcess", "IncludeLaunchDescription", "OpaqueFunction"),
    "launch.launch_description_sources": ("PythonLaunchDescriptionSource",),
    "launch_ros": (),
    "launch_ros.actions": ("ComposableNodeContainer", "Node"),
    "launch_ros.descriptions": ("ComposableNode",),
}


@dataclass
class Call:
    """What was called, and with what."""

    name: str
    positional: tuple[Any, ...] = ()
    named: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Any:
        return self.named[name]


@dataclass
class Configuration:
    """A LaunchConfiguration."""

    name: str

    def perform(self, context: dict[str, str]) -> str:
        return context[self.name]


def recorder(name: str) -> Any:
    return lambda *positional, **named: Call(name, positional, named)


@pytest.fixture(autouse=True)
def _stand_ins(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for module, names in MODULES.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, recorder(name))
        monkeypatch.setitem(sys.modules, module, stand_in)
    substitutions = ModuleType("launch.substitutions")
    substitutions.LaunchConfiguration = Configuration  # type: ignore[attr-defined]
    packages = ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = lambda _: str(PACKAGE)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "launch.substitutions", substitutions)
    monkeypatch.setitem(sys.modules, "ament_index_python", ModuleType("ament_index_python"))
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", packages)
    return


def launched(name_of_file: str, /, **given: str) -> list[Call]:
    """What a launch file starts, with its arguments by default unless they are given."""
    described = runpy.run_path(str(PACKAGE / "launch" / name_of_file))["generate_launch_description"]()
    context, started = {}, []
    for action in described.positional[0]:
        if action.name == "DeclareLaunchArgument":
            (name,) = action.positional
            context[name] = given.get(name, action["default_value"])
            assert action["description"]
        elif action.name == "OpaqueFunction":
            started += action["function"](context)
        else:
            started.append(action)
    assert {*given} <= {*context}
    return started


def test_a_rig_starts_by_itself() -> None:
    (node,) = launched("rig.launch.py")
    assert (node["package"], node["executable"], node["name"]) == ("autoexpose_ros", "rig", "rig")
    file, overriding = node["parameters"]
    assert file == str(PACKAGE / "config/rig.yaml")
    assert overriding == {"autostart": True}


def test_its_arguments_go_over_the_file() -> None:
    (node,) = launched("rig.launch.py", rig="scout", reliability="reliable", autostart="false", params="mine.yaml")
    assert node["name"] == "scout"
    assert node["parameters"] == ["mine.yaml", {"autostart": False, "reliability": "reliable"}]


def test_each_camera_has_its_image_proc() -> None:
    included, container = launched(
        "rig_image_proc.launch.py", rig="scout", namespace="/robot", cameras="left right top"
    )
    assert dict(included["launch_arguments"]) == {"reliability": "reliable"}
    nodes = container["composable_node_descriptions"]
    assert {node["namespace"] for node in nodes} == {f"/robot/scout/{camera}" for camera in ("left", "right", "top")}
    assert [node["plugin"] for node in nodes[:2]] == ["image_proc::DebayerNode", "image_proc::RectifyNode"]


def test_a_recording_is_played_into_the_topics_of_the_node() -> None:
    (player,) = launched("replay.launch.py", file="run.mcap", rig="scout")
    assert player["cmd"][:4] == ["ros2", "bag", "play", "run.mcap"]
    assert "/autoexpose/scout/left/image:=/scout/left/image_raw" in player["cmd"]
    assert "/autoexpose/scout/right/camera_info:=/scout/right/camera_info" in player["cmd"]


def test_the_file_of_parameters_has_what_the_node_declares() -> None:
    (of_all,) = yaml.safe_load((PACKAGE / "config/rig.yaml").read_text()).values()
    parameters = of_all["ros__parameters"]
    declared = (PACKAGE / "autoexpose_ros/rig_node.py").read_text()
    for name, value in parameters.items():
        shown = f'"{value}"' if isinstance(value, str) else str(value)
        assert f'self._declare("{name}", {shown}, ' in declared
    assert declared.count("self._declare(") == len(parameters) + 1  # autostart is for the launch file
