"""Features of a view, and how it lies against a map. Pure."""
