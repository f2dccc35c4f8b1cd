"""The cameras of a rig, each kept alive by its own threads."""
