"""Files with the geometry of cameras, as other programs write them: one file for each family of formats."""
