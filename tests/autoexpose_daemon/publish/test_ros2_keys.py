"""Names and marks of rmw_zenoh against its published examples, and by hand."""

from __future__ import annotations

from autoexpose_daemon.messages.keys import DEFAULT, LATCHED
from autoexpose_daemon.messages.types import CAMERA_INFO, EXPOSURE_INFO, IMAGE, ODOMETRY, TWIST, TYPESTORE
from autoexpose_daemon.publish.ros2_keys import Attachments, Ros2Node, Ros2Topic, key_of_topic

SESSION = "8b20917502ee955ac4476e0266340d5c"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
"""Of std_msgs/msg/String, in rmw_zenoh's docs/design.md."""
IMAGE_HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
"""As `ros2 topic info --verbose` of Jazzy has been seen to print it."""
CAMERA_INFO_HASH = "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
"""As in the tests of other programs that speak to ROS 2."""
NODE = Ros2Node(2, "talker", "autoexpose", SESSION)


def test_type_hashes_are_those_of_ros2() -> None:
    assert TYPESTORE.hash_rihs01("std_msgs/msg/String") == STRING_HASH
    assert TYPESTORE.hash_rihs01(IMAGE) == IMAGE_HASH
    assert TYPESTORE.hash_rihs01(CAMERA_INFO) == CAMERA_INFO_HASH


def test_a_key_is_domain_topic_type_and_hash() -> None:
    topic = NODE.topic(10, "talker/chatter", "std_msgs/msg/String")
    assert topic.key == f"2/talker/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    image = Ros2Node(0, "scout", "autoexpose", SESSION).topic(1, "scout/left/image", IMAGE)
    assert image.key == f"0/scout/left/image/sensor_msgs::msg::dds_::Image_/{IMAGE_HASH}"


def test_a_token_says_who_publishes_what_and_how() -> None:
    assert NODE.token == f"@ros2_lv/2/{SESSION}/0/0/NN/%/%talker/autoexpose"
    topic = NODE.topic(10, "talker/left/chatter", "std_msgs/msg/String")
    fields = topic.token.split("/")
    assert fields[:9] == ["@ros2_lv", "2", SESSION, "0", "10", "MP", "%", "%talker", "autoexpose"]
    assert fields[9:12] == ["%talker%left%chatter", "std_msgs::msg::dds_::String_", STRING_HASH]
    reliability, durability, history, deadline, lifespan, liveliness = fields[12].split(":")
    assert (reliability, durability, history) == ("2", "", ",5")  # best effort, volatile by default, keep last 5
    assert (deadline, lifespan, liveliness) == (",", ",", ",,")
    assert len(fields) == 13


def test_what_is_sent_once_is_kept_for_those_who_join_later() -> None:
    topic = NODE.topic(1, "talker/setup", "std_msgs/msg/String", LATCHED)
    assert topic.token.split("/")[-1] == ":1:,1:,:,:,,"


def test_a_node_without_a_namespace_sends_commands_reliably() -> None:
    node = Ros2Node(0, "", "autoexpose_repeat", SESSION)
    assert node.token == f"@ros2_lv/0/{SESSION}/0/0/NN/%/%/autoexpose_repeat"
    topic = node.topic(1, "cmd_vel", TWIST, DEFAULT)
    assert topic.key.startswith("0/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_")
    assert topic.token.split("/")[9] == "%cmd_vel"
    assert topic.token.split("/")[-1] == "::,10:,:,:,,"


def test_messages_of_a_topic_are_heard_whatever_their_hash() -> None:
    assert key_of_topic(3, "/odom", ODOMETRY) == "3/odom/nav_msgs::msg::dds_::Odometry_/*"
    assert key_of_topic(3, "base/cmd_vel") == "3/base/cmd_vel/*/*"


def test_our_own_type_is_named_and_hashed_alike() -> None:
    key = NODE.topic(1, "talker/left/exposure", EXPOSURE_INFO).key
    assert key.startswith("2/talker/left/exposure/autoexpose_msgs::msg::dds_::ExposureInfo_/RIHS01_")
    hashes = {TYPESTORE.hash_rihs01(message_type) for message_type in (IMAGE, CAMERA_INFO, EXPOSURE_INFO)}
    assert len(hashes) == 3


def test_an_attachment_is_number_time_and_gid() -> None:
    attachments = Attachments(Ros2Topic("key", "token"))
    first, second = attachments.next(0x0102_0304_0506_0708), attachments.next(-1)
    assert first[:8].hex() == "0100000000000000"  # the number, little-endian
    assert first[8:16].hex() == "0807060504030201"  # ns since 1970
    assert first[16] == 16  # length of the gid, which follows
    assert len(first) == 33
    assert second[:8].hex() == "0200000000000000"
    assert second[16:] == first[16:]
    assert Attachments(Ros2Topic("key", "another")).next(0)[17:] != first[17:]
