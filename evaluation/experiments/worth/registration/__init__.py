"""Registration with maps, outdoors."""
