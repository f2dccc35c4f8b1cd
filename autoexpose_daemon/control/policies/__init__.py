"""What decides on the exposure: each policy in a file of its own, and the table of them in `ids`."""
