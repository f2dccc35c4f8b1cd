"""Where shots come from: a live camera on a tripod, or files."""
