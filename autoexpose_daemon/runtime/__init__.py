"""The running daemon: from the rig's events to decisions, and back to the cameras."""
