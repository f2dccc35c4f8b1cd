"""What people write: text, numbers within bounds, files and YAML, read strictly and refused in one sentence."""
