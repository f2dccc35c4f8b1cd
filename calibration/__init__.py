"""What a camera does to light: its photometric response function and the predictions drawn from it."""
