"""Policy `belief`: remembers what light the scene sends, and plans the exposures of the next frames."""
