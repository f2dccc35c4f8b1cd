"""What control is told besides frames: the newest of each kind, while it is fresh."""
