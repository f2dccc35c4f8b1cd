"""What the cameras of the evaluation look at, and in which light."""
