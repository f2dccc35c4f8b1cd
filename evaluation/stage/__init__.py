"""A course in virtual time: frames for any exposure, the best exposure of each, and control loops with a delay."""
