"""The policies of papers: one file each."""
