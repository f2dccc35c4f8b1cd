"""The file of a response function, what it rests on, and whether it still holds."""
