"""The papers' experiments, repeated on the simulated rig: `autoexpose experiments`."""
