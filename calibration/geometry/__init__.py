"""The geometry of cameras: lens and place in the rig, as files hold it, and as a board in front of them shows it."""
