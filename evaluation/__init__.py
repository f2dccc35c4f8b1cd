"""Policies judged in closed loop and virtual time: the arena, stereo odometry, and the papers' experiments."""
