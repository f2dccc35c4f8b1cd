"""Experiments with odometry: what exposures are worth to it."""
