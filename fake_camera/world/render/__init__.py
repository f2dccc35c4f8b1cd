"""Images of textured rectangles, still or in motion."""
