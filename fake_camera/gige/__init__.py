"""The camera on GigE Vision."""
