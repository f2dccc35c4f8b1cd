"""Finding the maximum of a metric that is known at a few places only."""
