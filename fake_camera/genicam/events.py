"""Events that a camera sends unasked, as its description names them."""

EXPOSURE_END = 0x9001
"""The id of ExposureEnd, in the range of the cameras' own; its data are the frame id, eight bytes."""
