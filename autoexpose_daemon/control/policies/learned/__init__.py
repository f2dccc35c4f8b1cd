"""Policies whose law is a net with weights from `autoexpose train`: nothing is learnt at run time."""
