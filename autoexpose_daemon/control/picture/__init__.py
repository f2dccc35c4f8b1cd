"""What control sees of a frame: its picture, and which part of it counts."""
