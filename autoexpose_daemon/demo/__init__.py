"""The demo: the daemon on two fake cameras, and an honest report of what happened."""
