"""Frames and decisions as ROS 2 messages in CDR: the same bytes go to zenoh and into recordings. Needs rosbags."""
