"""Finding the maximum of a metric that is known only at a few points."""
