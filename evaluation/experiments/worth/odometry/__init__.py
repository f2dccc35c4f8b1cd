"""Odometry in rooms with natural texture."""
