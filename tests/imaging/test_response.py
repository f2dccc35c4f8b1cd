from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from calibration.response.file import ResponseFile
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction


def document() -> dict[str, object]:
    return {
        "format": "autoexpose-response/1",
        "log2_exposure": [grey / 32 for grey in range(256)],
        "black_level": 2,
        "saturation": 250,
    }


def write(path: Path, content: object) -> Path:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_linear_is_proportional_above_the_black_level() -> None:
    response = ResponseFunction.linear(black_level=10)
    assert response.intensity(response.inverse(np.array([35])) + 1.0)[0] == pytest.approx(60)
    assert (response.black_level, response.saturation) == (10, 255)


@pytest.mark.parametrize("black_level", [0, 16, 254])
def test_inverse_undoes_the_response(black_level: int) -> None:
    response = ResponseFunction.linear(black_level)
    greys = np.arange(black_level, 256)
    assert response.intensity(response.inverse(greys)) == pytest.approx(greys)


def test_inverse_between_whole_grey_levels_is_straight() -> None:
    response = ResponseFunction.linear()
    ends = response.inverse(np.array([40, 41]))
    assert response.inverse_between(np.array([40.0, 40.5, 41.0])) == pytest.approx([ends[0], ends.mean(), ends[1]])


def test_no_light_and_too_much_light_stay_within_black_and_saturation() -> None:
    response = ResponseFunction.linear(black_level=7)
    assert response.intensity(np.array([-100.0, 100.0])).tolist() == [7, 255]
    assert response.inverse(np.array([0]))[0] == response.log2_exposure[7]


def test_is_immutable() -> None:
    curve = np.linspace(0, 8, 256)
    response = ResponseFunction(curve, 0, 255)
    curve[0] = 99
    assert response.log2_exposure[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        response.log2_exposure[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        response.saturation = 3  # type: ignore[misc]


@given(st.lists(st.floats(0, 1), min_size=256, max_size=256), st.integers(0, 100), st.integers(101, 255))
def test_a_file_gives_back_the_curve_that_was_saved(
    tmp_path_factory: pytest.TempPathFactory, steps: list[float], black_level: int, saturation: int
) -> None:
    path = tmp_path_factory.mktemp("response") / "r.yaml"
    saved = ResponseFunction(np.cumsum(steps) + np.arange(256) / 64, black_level, saturation)
    ResponseFile(saved).save(path)
    loaded = ResponseFile.load(path).response
    assert loaded.log2_exposure == pytest.approx(saved.log2_exposure, abs=1e-6)
    assert (loaded.black_level, loaded.saturation) == (black_level, saturation)


CURVE = [grey / 32 for grey in range(256)]
BAD = {
    "format": ["autoexpose-response/2", None, 1],
    "log2_exposure": [
        None,
        7,
        CURVE[:255],
        [*CURVE, 9.0],
        ["x", *CURVE[1:]],
        [True, *CURVE[1:]],
        [[1.0], *CURVE[1:]],
        [*CURVE[:255], float("nan")],
        [*CURVE[:255], float("inf")],
        [*CURVE[:255], 10**400],
        CURVE[::-1],
        [0.0] * 256,
    ],
    "black_level": [-1, 250, 300, 2.0, "2", True, None],
    "saturation": [2, 256, 250.5, "x", None],
}


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in BAD.items() for value in values])
def test_a_bad_value_is_refused_with_file_and_key(tmp_path: Path, key: str, value: object) -> None:
    path = write(tmp_path / "bad.yaml", document() | {key: value})
    with pytest.raises(ConfigurationError) as error:
        ResponseFile.load(path)
    assert str(path) in str(error.value)
    assert key in str(error.value)


@pytest.mark.parametrize("key", list(document()))
def test_a_missing_key_is_named(tmp_path: Path, key: str) -> None:
    content = document()
    del content[key]
    with pytest.raises(ConfigurationError, match=f"'{key}' is missing"):
        ResponseFile.load(write(tmp_path / "r.yaml", content))


def test_an_unknown_key_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="unknown key 'vignette'"):
        ResponseFile.load(write(tmp_path / "r.yaml", document() | {"vignette": 1}))


@pytest.mark.parametrize(
    "content", [b"", b"- 1\n", b"text", b"{", b"\xff\xfe\x00", b"a: 2020-99-99", b"[" * 5000, b"%PDF-1.4\n"]
)
def test_a_file_that_is_no_response_file_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "r.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"r\.yaml"):
        ResponseFile.load(path)


def test_a_file_that_cannot_be_read_or_written_is_named(tmp_path: Path) -> None:
    missing = tmp_path / "nowhere" / "r.yaml"
    with pytest.raises(ConfigurationError, match="cannot be read"):
        ResponseFile.load(missing)
    with pytest.raises(ConfigurationError, match="cannot be written"):
        ResponseFile(ResponseFunction.linear()).save(missing)
