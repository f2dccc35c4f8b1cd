"""USB as any device has it: descriptors and bulk endpoints."""
