"""What the driver asks of a camera's GenICam nodes, whatever transport they are reached by."""
