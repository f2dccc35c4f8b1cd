"""What a lens lets through to each part of the picture: measured on a flat field, judged, and kept in a file."""
