"""What became of every trigger, and which write made which frame."""
