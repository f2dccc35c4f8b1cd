"""Majer et al. 2018, section 4.2: exposure by the top half of the image, and teach and repeat outdoors."""
