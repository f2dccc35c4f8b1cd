"""`autoexpose doctor`: what would keep the daemon from its cameras, found before one is opened."""
