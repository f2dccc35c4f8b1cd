"""Ratios of colours are recovered from a grey surface, and what they do to saturation and predictions holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from calibration.sweep import Shot
from calibration.white import (
    COLOURS,
    GreySurface,
    error_of,
    grey_surface,
    judge_balanced,
    judge_ratios,
    judge_surface,
    ratios_for,
)
from fake_camera.imaging import ImageSettings
from fake_camera.world.colour import WHITE, Tints, balanced
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.pixels import rgb_samples
from imaging.response import ResponseFunction, prediction_table
from tests.calibration.command_line import done, refused
from tests.fakes import fake_camera, unique

LINEAR = ResponseFunction.linear()
MODEL = SensorModel(width=320, height=240)
BOUNDS = dict.fromkeys(COLOURS, (0.0, 4.0))


def surface(
    colour: tuple[float, float, float] = (1, 1, 1), share: float = 1.2, ratios: dict[str, float] | None = None
) -> GreySurface:
    """A surface in light of a colour, `share` of a full well bright behind no filter; ratios by R, G and B."""
    sensor = Sensor(MODEL, 1)
    radiance = np.full((240, 320), share * MODEL.full_well_e / (MODEL.sensitivity_e_per_lux_s * 2e-3), np.float32)
    tints = Tints(np.zeros((240, 320), np.float32), np.array([colour], np.float32))
    chosen = ratios or dict.fromkeys("RGB", 1.0)
    settings = ImageSettings(
        2000.0, 0, 0, 1, "BayerRG8", 0, 0, 320, 240, 1, 1, balance_ratios=(chosen["R"], chosen["G"], chosen["B"])
    )
    shots = [
        Shot(rgb_samples(sensor.expose(radiance, settings, seed, tints), "RGGB"), 8, ExposureSetting(2000.0, 0.0))
        for seed in range(4)
    ]
    return grey_surface(shots, LINEAR)


def by_filter(ratios: dict[str, float]) -> dict[str, float]:
    return {colour[0]: ratio for colour, ratio in ratios.items()}


@pytest.mark.parametrize("colour", [(1, 1, 1), (1.3, 1, 0.7), (1.6, 0.9, 0.5)])
def test_the_fakes_filters_and_the_colour_of_the_light_are_recovered_within_the_stated_error(
    colour: tuple[float, float, float],
) -> None:
    first = surface(colour)
    ratios = ratios_for(first, COLOURS)
    after = surface(colour, share=0.8, ratios=by_filter(ratios))
    assert not [*judge_surface(first), *judge_ratios(ratios, BOUNDS), *judge_balanced(after)]
    true = np.array([WHITE[each[0]] / part for each, part in zip(COLOURS, colour, strict=True)])
    found = np.array(list(ratios.values())) / (true / true.min())
    assert np.abs(found / found.mean() - 1).max() <= error_of(first, after) <= 0.005
    assert min(ratios.values()) == 1.0


def test_a_camera_that_cannot_amplify_green_gets_ratios_to_green() -> None:
    ratios = ratios_for(surface(), ("Red", "Blue"))
    assert ratios == {"Red": pytest.approx(WHITE["R"], rel=0.003), "Blue": pytest.approx(WHITE["B"], rel=0.003)}
    ratios = ratios_for(surface((1.9, 0.8, 0.8), 1.0), ("Red", "Blue"))
    assert [finding.reason for finding in judge_ratios(ratios, BOUNDS)] == ["below_1"]


def test_bad_surfaces_are_refused_in_a_sentence() -> None:
    mixed = surface()
    mixed.cells[:, :4, 0] *= 1.4
    for seen, reason in (
        (surface(share=2.1), "clipped"),
        (surface(share=0.05), "too_dark"),
        (mixed, "not_grey"),
        (GreySurface(np.zeros(3), np.zeros((6, 8, 3)), 0.0), "too_dark"),
    ):
        assert [(found.severity, found.reason) for found in judge_surface(seen)] == [("refused", reason)]
    assert [found.reason for found in judge_ratios({"Blue": 5.0}, BOUNDS)] == ["out_of_range"]
    assert [found.reason for found in judge_balanced(surface((1.2, 1, 1), 0.8, WHITE))] == ["not_balanced"]
    assert [found.reason for found in judge_balanced(surface(share=2.1))] == ["clipped"]


@given(
    mosaic=arrays(np.uint8, (8, 8)),
    red=st.floats(1.0, 4.0),
    blue=st.floats(1.0, 4.0),
    saturation=st.integers(200, 255),
)
def test_what_the_sensor_clips_is_saturated_for_control_whatever_the_ratios(
    mosaic: np.ndarray, red: float, blue: float, saturation: int
) -> None:
    ratios = {"R": red, "G": 1.0, "B": blue}
    amplified = balanced(mosaic.copy(), "RGGB", 255, ratios)
    clipped = (mosaic >= saturation).reshape(4, 2, 4, 2).any(axis=(1, 3))
    frame = Frame(amplified, 8, 1, 0, 0, 0, ExposureSetting(1000.0, 0.0), layout="RGGB")
    assert (frame.grey8(saturation)[clipped] == 255).all()


def test_predictions_hold_for_amplified_colours_up_to_where_they_clip() -> None:
    """Digital ratios scale grey levels as light does, so that the camera's one response still predicts each colour."""
    table = prediction_table(LINEAR, -1.0)
    long, short = (rgb(part) for part in (1.0, 0.5))
    predicted = table[long]
    unclipped = long < 255
    assert np.abs(predicted.astype(int) - short)[unclipped].max() <= 2
    assert (predicted[~unclipped] == 128).all()
    assert (short[~unclipped] >= 127).all()


def rgb(part: float) -> np.ndarray:
    """A ramp of light through the fakes' filters, amplified to white; no noise."""
    ramp = np.linspace(0, 1.5, 200) * part
    light = np.minimum(np.outer(ramp, [1 / WHITE["R"], 1.0, 1 / WHITE["B"]]), 1.0)
    return np.minimum(np.rint(np.rint(255 * light) * [WHITE["R"], 1.0, WHITE["B"]]), 255).astype(np.uint8)


@pytest.mark.wire
def test_a_camera_is_balanced_over_the_wire_and_opens_with_what_is_pasted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    light, saved = tmp_path / "light.yaml", tmp_path / "white.yaml"
    light.write_text("light: [{at_s: 0, lux: 300}]")
    serial = unique("WHITE")[:15]
    options = ["--scene", "wall", "--light", str(light), "--pixel-format", "BayerRG8"]
    with fake_camera(serial, options=options):
        assert "verdict: believe it" in done("white", "--camera", serial, "--box", "100,100,200,200", "-o", str(saved))
        camera = yaml.safe_load(saved.read_text())["cameras"]["left"]
        found = {key: value for item in camera["features"] for key, value in item.items()}
        assert [found[f"BalanceRatioSelector[{colour}].BalanceRatio"] for colour in COLOURS] == pytest.approx(
            [WHITE[colour[0]] for colour in COLOURS], rel=0.005
        )
        output = done("white", "-c", str(saved))  # its own features do not matter
        for arguments, words in (
            (("--pixel-format", "Mono8"), f"camera {serial}: Mono8 has no red, green and blue to balance"),
            (("--box", "700,500,100,100"), "--box reaches to pixel (800, 600), but"),
            (("--box", "1,2,3"), "--box '1,2,3': give x,y,width,height"),
            (("--box", "0,0,8,8"), "is too small"),
            (("-o", str(saved)), "name a new file"),
        ):
            assert words in refused("white", "--camera", serial, *arguments)
        monkeypatch.setattr("calibration.commands.measure_gain.RATIO", "BalanceGain")
        output = refused("white", "--camera", serial)
        assert "it has no BalanceGain for red and blue" in output
    assert "one of --camera and --config" in refused("white")
