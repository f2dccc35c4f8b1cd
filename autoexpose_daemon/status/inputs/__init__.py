"""What the status says of each input of control other than frames: IMU, light ahead, tracking, requests."""
