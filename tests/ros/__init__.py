"""What of `ros/autoexpose_ros` runs without ROS 2."""
