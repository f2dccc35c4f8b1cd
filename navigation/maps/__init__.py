"""How maps change with what is seen, and what of them will be seen when. Pure."""
