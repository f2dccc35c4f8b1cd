from __future__ import annotations

from drivers.pixel_format import PixelFormat
from fake_camera.imaging import PIXEL_FORMATS


def test_the_fake_camera_has_the_same_formats() -> None:
    """The two tables are independent, as in a real camera and host."""
    ours = {name: (row.pfnc_code, row.bit_depth, row.bits_per_pixel, row.dtype) for name, row in PIXEL_FORMATS.items()}
    theirs = {row.value: (row.pfnc_code, row.bit_depth, row.bits_per_pixel, row.dtype) for row in PixelFormat}
    assert ours == theirs
