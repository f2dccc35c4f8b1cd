"""Makes the weights of the learned policies, on simulated scenes that may be tuned on."""
