"""`autoexpose ros2`: what the daemon publishes, as topics of ROS 2 over DDS, its default middleware."""
