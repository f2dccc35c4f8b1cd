"""What the cameras of the evaluation look at, and under which light."""
