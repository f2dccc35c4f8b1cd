"""What the status says about each input of control other than frames: IMU, light ahead, tracking, requests."""
