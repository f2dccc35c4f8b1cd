"""The pixels of frames: what they hold, and the formats in which they arrive."""
