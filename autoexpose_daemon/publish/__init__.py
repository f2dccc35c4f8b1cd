"""Frames to other processes and machines, through zenoh."""
