"""The daemon's configuration: YAML on disk, checked before anything is opened."""
