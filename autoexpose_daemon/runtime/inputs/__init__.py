"""What control is given besides frames: the newest of each kind, while it is fresh."""
