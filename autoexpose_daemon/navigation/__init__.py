"""Teach and repeat: finds the way along a taught path again. A program of its own; the daemon knows nothing of it."""
