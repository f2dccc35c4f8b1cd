"""What a camera sees: a scene under a light script, through a sensor."""
