"""What is requested of control while it runs."""
