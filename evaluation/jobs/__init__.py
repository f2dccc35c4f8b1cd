"""Long work as jobs: each named by all that its result depends on, kept, and run here or on a cluster."""
