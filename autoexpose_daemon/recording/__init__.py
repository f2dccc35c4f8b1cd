"""Runs kept on disk, and played again through any policy."""
