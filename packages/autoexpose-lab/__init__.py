"""More commands for `autoexpose`: teach and repeat, and the comparison of policies in simulation and on recordings."""
