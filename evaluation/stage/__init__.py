"""One course in virtual time: frames for any exposure, and policies in closed loop on them."""
