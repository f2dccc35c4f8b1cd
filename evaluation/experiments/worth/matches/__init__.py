"""The judge of matches on photographs: scenes, cameras, courses, scores and bounds."""
