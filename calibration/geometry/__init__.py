"""The geometry of cameras: lens and place in the rig, as files hold it, and how a board in front of them tells it."""
