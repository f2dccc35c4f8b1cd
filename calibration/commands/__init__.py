"""`autoexpose calibrate`: what the user runs, and what it puts together."""
