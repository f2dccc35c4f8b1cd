"""Cameras whose clocks are kept at one time by IEEE 1588, the Precision Time Protocol (PTP)."""
