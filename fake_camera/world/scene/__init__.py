"""What the cameras see, and their path."""
