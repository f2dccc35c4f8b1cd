"""What there is to see, and the way through it."""
