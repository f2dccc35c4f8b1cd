"""The papers' experiments, done again on the simulated rig: `autoexpose experiments`."""
