"""Looks at a flat field through a simulated lens of known vignetting."""

from __future__ import annotations

import numpy as np

from calibration.sweep import Shot
from calibration.vignetting.field import FieldLook, field_of
from fake_camera.imaging import ImageSettings
from fake_camera.world.sensor import Sensor, SensorModel, falloff
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

LONG_US = 2000.0
LINEAR = ResponseFunction.linear()


def gamma_response() -> ResponseFunction:
    """Of a sensor with the curve `gamma`."""
    return ResponseFunction(2.2 * np.log2(np.maximum(np.arange(256), 0.5) / 255), 0, 255)


def looks(
    lens: np.ndarray | float,
    response: ResponseFunction = LINEAR,
    *,
    curve: str = "linear",
    tilt: float = 0.0,
    count: int = 8,
    share: float = 0.7,
    changes: float = 0.0,
) -> list[FieldLook]:
    """Looks through a lens: its relative light, or what it leaves in the corners of the fakes.

    `tilt` is how much the light changes across the surface, which is turned from look to look; `share` is how bright
    it is, of the full well; `changes` is by how much the light rises in each look.
    """
    model = SensorModel(width=360, height=270, corner_light=lens if isinstance(lens, float) else 1.0)
    sensor = Sensor(model, 1, curve)
    y, x = np.mgrid[: model.height, : model.width]
    lit = share * model.full_well_e / (model.sensitivity_e_per_lux_s * LONG_US * 1e-6)
    rng, taken = np.random.default_rng(5), []
    for number in range(count):
        angle = rng.uniform(0, 2 * np.pi)
        slope = tilt * (np.cos(angle) * (x / model.width - 0.5) + np.sin(angle) * (y / model.height - 0.5))
        light = lit * (1 + changes * number) * (1 + slope)
        if isinstance(lens, np.ndarray):
            light = light * lens
        fields = []
        for part in (1.0, 0.5):
            settings = ImageSettings(LONG_US * part, 0, 0, 1, "Mono8", 0, 0, model.width, model.height, 1, 1)
            exposure = ExposureSetting(LONG_US * part, 0.0)
            pixels = (sensor.expose(light.astype(np.float32), settings, 100 * number + k) for k in range(4))
            fields.append(field_of([Shot(each, 8, exposure) for each in pixels], response))
        taken.append(FieldLook(*fields, 0.5))
    return taken


def truth(corner_light: float) -> np.ndarray:
    """Of the fakes' lens, shape (270, 360)."""
    return falloff(SensorModel(width=360, height=270, corner_light=corner_light))


def worst(vignetting: Vignetting, lens: np.ndarray) -> float:
    """How far a vignetting is from the truth anywhere, as a share of the light; a common factor is nobody's."""
    ratio = vignetting.relative_light(*lens.shape) / lens
    return float(np.abs(ratio / np.median(ratio) - 1.0).max())
