"""What people write for the rig: files and YAML, read strictly, and numbers within bounds."""
