"""From a sweep to a response function."""
