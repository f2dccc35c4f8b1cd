"""Cameras whose clocks IEEE 1588, the Precision Time Protocol (PTP), keeps at one time."""
