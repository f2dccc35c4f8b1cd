"""Reasons not to believe looks at a flat field, or what follows from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calibration.findings import Finding
from calibration.vignetting.field import Array
from calibration.vignetting.look import Look
from imaging.vignetting import LEAST_LIGHT

LEAST_LOOKS = 4
MOST_CLIPPED = 1e-3
"""Single pixels may be hot; more of them mean a lamp, or too much light."""
LEAST_GREY = 0.1
MOST_TEXTURE = 0.03
"""Differences within a cell: paper and frosted glass show 1 %, and vignetting across a cell as much."""
MOST_UNEVEN = 0.02
"""Deviations of cells from anything that changes smoothly over the picture."""
GOOD_CHANGE, USABLE_CHANGE = 0.1, 0.3
"""Change of the light from look to look: a surface that is moved may catch more or less of it."""
GOOD_SLOPE, USABLE_SLOPE = 0.03, 0.1
"""By how much light and grey levels may be out of proportion, in stops for each stop."""
GOOD_TILT, USABLE_TILT = 0.05, 0.15
"""Difference between opposite places; a lens that is a twentieth of the picture off centre shows as much."""
GOOD_ERROR, USABLE_ERROR = 0.02, 0.1


def judge_looks(looks: Sequence[Look]) -> Iterator[Finding]:
    """What is wrong with the looks themselves."""
    if len(looks) < LEAST_LOOKS:
        text = f"{len(looks)} pictures: take at least {LEAST_LOOKS}, better 8, from several places of the surface"
        yield Finding("refused", "few_looks", text)
        return
    fields = [look.field for look in looks]
    clipped, grey = max(field.clipped for field in fields), min(field.grey for field in fields)
    if clipped > MOST_CLIPPED:
        text = (
            f"{clipped:.1%} of the picture is saturated: keep lamps and reflections out of it, and take pictures with "
            "a shorter exposure time"
        )
        yield Finding("refused", "saturated", text)
        return
    if grey < LEAST_GREY:
        text = f"the picture is {grey:.0%} of full scale bright: use brighter light, or a longer exposure time"
        yield Finding("refused", "too_dark", text)
        return
    texture = max(field.texture for field in fields)
    if texture > MOST_TEXTURE:
        yield _not_flat(f"neighbouring parts of it differ by {texture:.0%}")
        return
    yield from _judge_light(looks)


def judge_flatness(unevenness: float) -> Iterator[Finding]:
    """Whether looks change smoothly over the picture: `unevenness` is their deviation from anything that does."""
    if unevenness > MOST_UNEVEN:
        yield _not_flat(f"its parts differ by {unevenness:.0%} from anything smooth")


def judge_result(mean: Array, error: float) -> Iterator[Finding]:
    """What is wrong with the mean of the looks, and with what follows from it."""
    tilt = float(np.abs(mean / np.maximum(mean[::-1, ::-1], LEAST_LIGHT) - 1.0).max()) / 2.0
    if tilt > GOOD_TILT:
        text = (
            f"opposite parts of the picture differ by up to {2 * tilt:.0%}: the surface is lit from one side, or the "
            "lens is far off the centre; turn the camera half a turn for half of the looks"
        )
        yield Finding("refused" if tilt > USABLE_TILT else "warned", "uneven_light", text)
    if error > GOOD_ERROR:
        text = (
            f"relative light is known to {error:.1%} only, as the looks differ or no smooth lens explains them: use a "
            "surface that is lit more evenly, and take more looks"
        )
        yield Finding("refused" if error > USABLE_ERROR else "warned", "inconsistent", text)


def _judge_light(looks: Sequence[Look]) -> Iterator[Finding]:
    """Whether the light stayed the same and grey levels follow it, which looks at two exposure times show."""
    slopes = [look.slope for look in looks if look.slope is not None]
    if not slopes:
        return
    levels = np.array([look.field.level for look in looks])
    change = float(levels.max() / levels.min() - 1.0)
    if change > GOOD_CHANGE:
        text = (
            f"the light changed by {change:.0%} from look to look: use light that neither changes nor flickers, and "
            "keep the same part of the surface in view"
        )
        yield Finding("refused" if change > USABLE_CHANGE else "warned", "light_changed", text)
    wrong = abs(float(np.median(slopes)) - 1.0)
    if wrong > GOOD_SLOPE:
        text = (
            f"half the exposure time gives {2.0 ** -float(np.median(slopes)):.3f} of the light, by the response: "
            "grey levels are not in proportion to light; measure the response first (autoexpose calibrate response), "
            "and give its file"
        )
        yield Finding("refused" if wrong > USABLE_SLOPE else "warned", "wrong_response", text)


def _not_flat(seen: str) -> Finding:
    text = f"the surface is not uniform: {seen}: show an evenly lit white wall or paper, or a diffuser, out of focus"
    return Finding("refused", "not_flat", text)
