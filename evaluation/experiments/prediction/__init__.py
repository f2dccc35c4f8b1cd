"""Experiments on prediction: what an image says about other exposures of the same view."""
