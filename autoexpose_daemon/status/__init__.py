"""How the daemon is: counted, measured, described, and shown in a terminal."""
