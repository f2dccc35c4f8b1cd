"""Exposure settings, frames, Aravis cameras, and the stereo rig that accounts for every trigger."""
