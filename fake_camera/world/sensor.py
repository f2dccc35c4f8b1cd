"""A machine-vision sensor after the EMVA 1288 model: from radiance to grey levels."""

# Compiled kernels take plain arrays and numbers, by position:
# ruff: noqa: PLR0917

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fake_camera.imaging import PIXEL_FORMATS, ImageSettings, Pixels
from fake_camera.world.colour import WHITE, Tints, balanced, filtered, grey_light, mosaic_of, with_colours
from fake_camera.world.compiled import compiled
from fake_camera.world.response import response_table

_STEPS = 1 << 16
"""Steps of the converter, finer than any pixel format, so that the format alone decides the quantisation."""

_POOL = 1 << 20
"""Normal deviates, drawn once (4 MB): drawing 390000 for each frame would cost more than rendering it."""


DEFAULT_F_NUMBER = 0.9
"""The default lens, faster than what robots carry; the paper of Begin & Hunter 2022 had f/1.2, many robots f/2.8.

It follows from 73000 electrons per lux second: a white lamp gives some 9e15 photons per second and m^2 for each lux. Of
those that leave a white surface, 0.9 / (4 F^2) pass the lens; a pixel of 4.8e-11 m^2 turns 0.6 of its share into
electrons. That makes 58000 / F^2.
"""


SIZES = ((720, 540), (1440, 1080), (2048, 1536), (2448, 2048))
"""Widths and heights of the sensors that can be simulated, pixels; larger ones differ from the first only in size."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Parameters of a sensor behind its lens, by default like a Sony IMX287 (6.9 um pixels, global shutter).

    At 0 dB the full well is the full scale of the output. Quantum efficiency, pixel area and the lens are folded into
    the sensitivity. `corner_light` is what the lens lets through to the corners, as a share of the centre: see
    `falloff`. With the default lens a white surface (0.9) under 150 lux fills 90 % of the well in 2 ms, and a
    grey one (0.4) under 1 lux gives 80 of 255 grey levels in 7.5 ms at 30 dB.
    """

    width: int = 720
    height: int = 540
    full_well_e: float = 22000.0
    read_noise_e: float = 3.0
    dark_current_e_per_s: float = 10.0
    lens_f_number: float = DEFAULT_F_NUMBER
    corner_light: float = 1.0

    @property
    def sensitivity_e_per_lux_s(self) -> float:
        """Electrons per second in a pixel that sees a white surface in a light of 1 lux."""
        return 73000.0 * (DEFAULT_F_NUMBER / self.lens_f_number) ** 2

    def system_gain(self, pixel_format: str, gain_db: float) -> float:
        """EMVA 1288's overall system gain K, in grey levels per electron."""
        return PIXEL_FORMATS[pixel_format].max_grey / self.full_well_e * math.pow(10.0, gain_db / 20.0)


def falloff(model: SensorModel) -> NDArray[np.float32]:
    """The light that reaches each pixel as a share of that in the centre, shape (height, width): cos^4 of an angle.

    The angle is that of a pinhole, with the focal length at which corners get `SensorModel.corner_light`.
    """
    y, x = np.ogrid[: model.height, : model.width]
    across, down = x - (model.width - 1) / 2, y - (model.height - 1) / 2
    tangent2 = (across**2 + down**2) / ((model.width**2 + model.height**2) / 4) * (model.corner_light**-0.5 - 1.0)
    return np.asarray((1.0 + tangent2) ** -2, np.float32)


class Sensor:
    """Exposes images of one simulated sensor. Not thread-safe.

    Parameters
    ----------
    model
        The sensor's parameters.
    seed
        Seed of the pool of normal deviates for all noise.
    response
        Name of the response function (`fake_camera.world.response.CURVES`).
    """

    def __init__(self, model: SensorModel, seed: int, response: str = "linear") -> None:
        self.model = model
        pool = np.random.default_rng(seed).standard_normal(_POOL)
        self._normals = ((pool - pool.mean()) / pool.std()).astype(np.float32)
        self._falloff = None if model.corner_light == 1.0 else falloff(model)
        self._response = response_table(response, _STEPS)
        self._table_of = ("", 0.0)
        self._table: NDArray[np.uint8] | NDArray[np.uint16] = np.empty(0, np.uint8)

    def expose(
        self,
        radiance: NDArray[np.float32],
        settings: ImageSettings,
        noise_seed: int,
        tints: Tints | None = None,
    ) -> Pixels:
        """Take one image.

        Raises ValueError when the region is not within the sensor.

        Parameters
        ----------
        radiance
            Mean radiance during the exposure in lux times reflectance, shape (model.height, model.width).
        settings
            Exposure time, gain, region, binning and output of this frame.
        noise_seed
            From 0 to 2**64 - 1; equal seeds give equal noise.
        tints
            The colours of the light, for colour formats; None: grey.

        Returns
        -------
        As from `ImageSource.take`.
        """
        if self._falloff is not None:
            radiance = radiance * self._falloff
        exposure_s = settings.exposure_time_us * 1e-6
        pixels = settings.binning_horizontal * settings.binning_vertical
        table = self._greys(settings.pixel_format, settings.gamma)
        pixel_format = PIXEL_FORMATS[settings.pixel_format]
        mosaic = mosaic_of(pixel_format)
        charged = self._charged(radiance, settings)
        if mosaic:
            charged = filtered(charged, _in_region(tints or grey_light(radiance.shape), settings), mosaic)
        image: Pixels = np.empty((settings.height, settings.width), table.dtype)
        _expose(
            charged,
            np.float32(self.model.sensitivity_e_per_lux_s * exposure_s),
            np.float32(self.model.dark_current_e_per_s * exposure_s * pixels),
            np.float32(self.model.read_noise_e**2),
            np.float32(self.model.full_well_e),
            np.float32((_STEPS - 1) / self.model.full_well_e * 10.0 ** (settings.gain_db / 20.0)),
            np.float32((_STEPS - 1) * settings.black_level_percent / 100.0 + 0.5),
            self._normals,
            np.uint64(noise_seed),
            table,
            image,
        )
        if mosaic:
            ratios = WHITE if settings.balances_white else dict(zip("RGB", settings.balance_ratios, strict=True))
            image = balanced(image, mosaic, pixel_format.max_grey, ratios)
        return image if mosaic == pixel_format.colours else with_colours(image, pixel_format.colours)

    def _charged(self, radiance: NDArray[np.float32], settings: ImageSettings) -> NDArray[np.float32]:
        """Radiance summed over the pixels of each bin, mirrored, and cut to the region; a bin holds one full well."""
        across, down = settings.binning_horizontal, settings.binning_vertical
        rows, columns = self.model.height // down, self.model.width // across
        right, bottom = settings.offset_x + settings.width, settings.offset_y + settings.height
        if min(settings.offset_x, settings.offset_y) < 0 or right > columns or bottom > rows:
            raise ValueError(
                f"a region of {settings.width}x{settings.height} pixels at ({settings.offset_x}, {settings.offset_y}) "
                f"does not fit into {columns}x{rows} pixels: make it smaller or move it"
            )
        if across > 1 or down > 1:
            whole = radiance[: rows * down, : columns * across]
            # A mean by area, scaled: numpy's sum over two axes takes fifty times as long, a quarter of a frame period.
            mean = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
            radiance = np.asarray(mean, np.float32) * np.float32(across * down)
        radiance = radiance[:: -1 if settings.reverse_y else 1, :: -1 if settings.reverse_x else 1]
        return np.ascontiguousarray(radiance[settings.offset_y : bottom, settings.offset_x : right])

    def _greys(self, pixel_format: str, gamma: float) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Grey level of every converter step: response function, then the Gamma node, then quantisation."""
        if self._table_of != (pixel_format, gamma):
            greys = np.rint(self._response**gamma * PIXEL_FORMATS[pixel_format].max_grey)
            self._table = greys.astype(PIXEL_FORMATS[pixel_format].dtype)
            self._table_of = (pixel_format, gamma)
        return self._table


def _in_region(tints: Tints, settings: ImageSettings) -> Tints:
    """The tints of the pixels in the region of interest; a bin has that of its first pixel."""
    down, across = settings.binning_vertical, settings.binning_horizontal
    height, width = tints.numbers.shape
    binned = tints.numbers[: height // down * down : down, : width // across * across : across]
    binned = binned[:: -1 if settings.reverse_y else 1, :: -1 if settings.reverse_x else 1]
    rows = slice(settings.offset_y, settings.offset_y + settings.height)
    columns = slice(settings.offset_x, settings.offset_x + settings.width)
    return Tints(binned[rows, columns], tints.colours)


@compiled(fastmath=True)
def _expose(  # type: ignore[no-untyped-def]
    radiance, e_per_radiance, dark_e, read_variance, full_well, steps_per_e, offset, normals, seed, table, image
):
    """Electrons, shot and read noise as one normal deviate, full well, gain, black level, converter, table.

    Read noise joins the shot noise before the full well clips, so that a saturated pixel is free of noise. The black
    level is added before the converter, which would otherwise clip the lower half of the noise in the dark.
    """
    height, width = radiance.shape
    top = np.float32(table.size - 1)
    zero = np.float32(0.0)
    steps = np.empty(width, np.int32)
    state = seed
    for y in range(height):
        # SplitMix64: each row starts at its own place in the pool, so that noise does not shift from frame to frame.
        state += np.uint64(0x9E3779B97F4A7C15)
        mixed = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
        start = np.int64(mixed % np.uint64(normals.size - width))
        deviates = normals[start : start + width]
        for x in range(width):
            mean = radiance[y, x] * e_per_radiance + dark_e
            electrons = min(mean + np.sqrt(mean + read_variance) * deviates[x], full_well)
            steps[x] = np.int32(min(max(electrons * steps_per_e + offset, zero), top))
        for x in range(width):
            image[y, x] = table[steps[x]]
