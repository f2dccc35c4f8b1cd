"""What consumers that steer gain, and what those that lie cost."""
