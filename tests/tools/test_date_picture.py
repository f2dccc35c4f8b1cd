"""The day below a picture of the docs."""

from __future__ import annotations

from datetime import date

import numpy as np
from PIL import Image

from tools.date_picture import dated


def test_a_picture_keeps_what_it_shows_and_gets_its_day_below() -> None:
    picture = Image.new("RGB", (200, 40), (240, 240, 240))
    picture.paste((10, 60, 110), (20, 5, 60, 30))
    first, other = (np.asarray(dated(picture, date(2026, 11, day)).convert("RGB")) for day in (28, 29))
    np.testing.assert_allclose(first[:40].astype(int), np.asarray(picture), atol=2)
    assert (first[40:] < 200).any() and (first[40:] > 230).any()
    assert (first[40:] != other[40:]).any()
