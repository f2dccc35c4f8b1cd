"""Measures of an image."""
