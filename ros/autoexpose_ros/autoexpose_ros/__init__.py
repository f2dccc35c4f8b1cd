"""The cameras of an autoexpose daemon in ROS 2. Only `*_node.py`, `frame_topics.py` and `controls.py` need rclpy."""
