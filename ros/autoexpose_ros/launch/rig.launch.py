"""One rig: `ros2 launch autoexpose_ros rig.launch.py`. The daemon runs already, on this machine or another."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PARAMETERS = str(Path(get_package_share_directory("autoexpose_ros"), "config", "rig.yaml"))

ARGUMENTS = {
    "rig": ("rig", "the node's name, and `publish.rig` of the daemon's configuration"),
    "namespace": ("", "of the node; its topics are below NAMESPACE/RIG"),
    "params": (PARAMETERS, "a file of parameters, such as a copy of config/rig.yaml"),
    "connect": ("", "zenoh endpoints of the daemon; empty: as the file says"),
    "reliability": ("", "best_effort or reliable; empty: as the file says"),
    "autostart": ("true", "configure and activate by itself; false: a lifecycle manager does"),
    "log_level": ("info", "of the node"),
}


def rig(context: LaunchContext) -> list[Node]:
    """The node."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    over_file = {name: given[name] for name in ("connect", "reliability") if given[name]}
    node = Node(
        package="autoexpose_ros",
        executable="rig",
        name=given["rig"],
        namespace=given["namespace"],
        parameters=[given["params"], {"autostart": given["autostart"].lower() == "true", **over_file}],
        arguments=["--ros-args", "--log-level", given["log_level"]],
        output="screen",
    )
    return [node]


def generate_launch_description() -> LaunchDescription:
    """The arguments, and the node."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, (default, words) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=rig)])
