"""Experiments on prediction: what an image tells about other exposures of it."""
