"""What the numbers of a gain that is not in dB mean: measured, judged, and kept in a file."""
