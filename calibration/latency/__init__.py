"""How many frames a write takes to show."""
