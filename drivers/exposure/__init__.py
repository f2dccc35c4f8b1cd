"""Exposure time and gain: settings, limits, and gains that are not in dB."""

from drivers.exposure.setting import DB_PER_STOP, ExposureLimits, ExposureSetting, linear_gain

__all__ = ["DB_PER_STOP", "ExposureLimits", "ExposureSetting", "linear_gain"]
