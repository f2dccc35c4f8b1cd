"""Simulated sweeps of a camera, sound and spoilt, and whether calibration states their error honestly."""
