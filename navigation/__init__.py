"""Teach and repeat: finds the way along a taught path again. A separate program; the daemon knows nothing about it."""
