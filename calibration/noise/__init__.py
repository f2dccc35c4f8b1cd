"""Photon transfer: system gain, read noise, black level and full well."""
