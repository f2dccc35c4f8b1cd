"""What decides on the exposure: the policies, and the table of them in `ids`."""
