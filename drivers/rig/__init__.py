"""The cameras of a rig, each kept alive by threads of its own."""
