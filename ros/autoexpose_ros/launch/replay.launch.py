"""A recording into the topics of the node: `ros2 launch autoexpose_ros replay.launch.py file:=run.mcap`.

The recording is MCAP, which `ros2 bag play` reads (in Humble with ros-humble-rosbag2-storage-mcap). Earlier recordings
call the topics after the daemon's keys, and so they are given the node's names.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

ARGUMENTS = {
    "file": (None, "the recording"),
    "rig": ("rig", "`publish.rig` of the configuration with which it was recorded"),
    "cameras": ("left right", "names of the cameras, with blanks between them"),
    "rate": ("1.0", "how many times as fast"),
}
TOPICS = {"image": "image_raw", "camera_info": "camera_info", "exposure": "exposure"}
"""The names in earlier recordings, and the node's."""


def play(context: LaunchContext) -> list[ExecuteProcess]:
    """`ros2 bag play`, with /clock for nodes that use_sim_time."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    rig = given["rig"]
    names = [
        f"/autoexpose/{rig}/{camera}/{early}:=/{rig}/{camera}/{name}"
        for camera in given["cameras"].split()
        for early, name in TOPICS.items()
    ]
    command = ["ros2", "bag", "play", given["file"], "--clock", "--rate", given["rate"], "--remap", *names]
    return [ExecuteProcess(cmd=command, output="screen")]


def generate_launch_description() -> LaunchDescription:
    """The arguments, and the player."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=words)
        for name, (default, words) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=play)])
