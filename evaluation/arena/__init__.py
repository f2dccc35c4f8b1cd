"""The arena: every policy through every scenario, against the best exposure."""
