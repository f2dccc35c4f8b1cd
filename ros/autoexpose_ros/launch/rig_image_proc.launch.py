"""One rig, and image_proc for each camera: image_mono, image_color and image_rect beside image_raw."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import ComposableNodeContainer
from launch_ros.descriptions import ComposableNode

LAUNCH = Path(get_package_share_directory("autoexpose_ros"), "launch")

ARGUMENTS = {
    "rig": ("rig", "as of rig.launch.py, whose other arguments may be given, too"),
    "namespace": ("", "as of rig.launch.py"),
    "cameras": ("left right", "names of the cameras, with blanks between them"),
}


def image_proc(context: LaunchContext) -> list[ComposableNodeContainer]:
    """Colour from a mosaic, then lines that are straight; grey passes through the first."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    rig = "/".join(filter(None, (given["namespace"].strip("/"), given["rig"])))
    nodes = []
    for camera in given["cameras"].split():
        of_camera = f"/{rig}/{camera}"
        nodes += [
            ComposableNode(package="image_proc", plugin="image_proc::DebayerNode", name="debayer", namespace=of_camera),
            ComposableNode(
                package="image_proc",
                plugin="image_proc::RectifyNode",
                name="rectify",
                namespace=of_camera,
                remappings=[("image", "image_mono")],
            ),
        ]
    container = ComposableNodeContainer(
        package="rclcpp_components",
        executable="component_container_mt",
        name="image_proc",
        namespace=f"/{rig}",
        composable_node_descriptions=nodes,
        output="screen",
    )
    return [container]


def generate_launch_description() -> LaunchDescription:
    """The arguments, the rig, and what processes its images."""
    rig = PythonLaunchDescriptionSource(str(LAUNCH / "rig.launch.py"))
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, (default, words) in ARGUMENTS.items()
    ]
    # image_proc insists on reliable delivery unless told otherwise.
    included = IncludeLaunchDescription(rig, launch_arguments={"reliability": "reliable"}.items())
    return LaunchDescription([*declared, included, OpaqueFunction(function=image_proc)])
