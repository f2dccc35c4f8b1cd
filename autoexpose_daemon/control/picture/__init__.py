"""What control sees of a frame: its picture, and the part of that which counts."""
