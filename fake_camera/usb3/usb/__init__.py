"""The USB below USB3 Vision: descriptors, endpoints, and USB/IP."""
