"""The arena: every policy through every scenario, in closed loop and virtual time, against the best exposure."""
