"""What a map went through, as a page: `autoexpose map report`."""
