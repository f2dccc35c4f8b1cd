"""How the daemon is: counted, measured, judged, described, and shown in a terminal."""
