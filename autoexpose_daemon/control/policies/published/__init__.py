"""The policies of papers."""
