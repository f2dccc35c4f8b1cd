"""Writes the day below a picture: python -m tools.date_picture PICTURE.png DATED.png"""

from __future__ import annotations

import sys
from datetime import date
from pathlib import Path

from PIL import Image, ImageDraw

_STRIP_PX, _MARGIN_PX = 18, 6
_COLOURS = 256
_GREY = (128, 128, 128)


def dated(picture: Image.Image, day: date) -> Image.Image:
    """The picture with a strip of its own ground below, and the day at the right of it; of few colours, in half the
    bytes."""
    picture = picture.convert("RGB")
    width, height = picture.size
    ground = picture.getpixel((0, height - 1))
    strip = Image.new("RGB", (width, height + _STRIP_PX), ground)
    strip.paste(picture)
    middle = height + _STRIP_PX // 2
    ImageDraw.Draw(strip).text((width - _MARGIN_PX, middle), f"made {day.isoformat()}", _GREY, anchor="rm")
    return strip.quantize(_COLOURS, dither=Image.Dither.NONE)


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    with Image.open(source) as picture:
        dated(picture, date.today()).save(target, optimize=True)
