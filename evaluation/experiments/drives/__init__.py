"""Experiments that drive: what exposures are worth to odometry."""
