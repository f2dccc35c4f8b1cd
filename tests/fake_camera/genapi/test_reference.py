"""EMVA's reference GenApi, which nobody here wrote, examines the fake cameras; and every real description makes one."""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from fake_camera.device.device import Device
from fake_camera.genapi.description import Description
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.formula import FormulaError, compile_formula
from fake_camera.genapi.xml_camera import XmlCamera
from tests.data import DATA
from tests.fake_camera.gige.gige_client import Ramp
from tests.xml_shapes import DRIVEN, FREE_ONLY

needs_reference = pytest.mark.skipif(
    importlib.util.find_spec("genicam") is None, reason="EMVA's reference GenApi is not installed: pip install genicam"
)

UNSOUND = ("blanks", "boundless gain", "increments of zero")
"""Shapes against the rules, as some cameras are: in the schema, in limits that are no numbers, in increments."""
SHAPES = [name for name in (*DRIVEN, *FREE_ONLY) if name not in UNSOUND]
OWN = [*(f"combination {number}" for number in (0, 1, 2, 7, 10, 16)), *SHAPES, "gige", "usb3"]
"""Each way of writing registers, with chunks and without; each shape; the fakes' own descriptions."""
REAL = sorted(str(path) for path in DATA.glob("genicam_xml/**/*.xml"))
EXPLAINED = {
    ("values", "RegOffsetValueInt"): "4.0 in an integer formula: no value for the reference, taken by Aravis and us",
}
"""Where the readers differ, and why it stays so."""
NOT_WRITTEN = {
    "GevCCP": "the control privilege is the control channel's, which the examiner goes around",
    "GevCurrentIPConfiguration": "the fakes' address is that of the loopback interface",
    "ChunkModeActive": "AVT has it in GevSCCFG, whose bit for extended chunk data the fakes do not have",
    "U3V": "the privilege and the configuration of the device and of its streams are fixed",
}
"""Features, by how they begin, in registers of the transport that the fakes do not let be written, and why."""


def examine(names: Sequence[str]) -> dict[str, Any]:
    """The findings on some descriptions, in a process that the reference may end."""
    command = [sys.executable, "-m", "tests.fake_camera.genapi.examiner", *names]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=110)
    assert result.returncode == 0, result.stderr[-2000:]
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def check(findings: dict[str, Any]) -> None:
    differ = [finding for finding in findings["differ"] if tuple(finding[:2]) not in EXPLAINED]
    fixed = ("WRITE_PROTECT", *NOT_WRITTEN)
    unusable = [(name, why) for name, why in findings["unusable"] if why != fixed[0] or not name.startswith(fixed[1:])]
    assert (differ, unusable) == ([], [])


@needs_reference
def test_the_reference_reads_our_own_descriptions_as_we_do_and_each_feature_takes_its_value_back() -> None:
    found = examine(OWN)
    for name, findings in found.items():
        check(findings)
        assert findings["usable"] >= 12, name


@needs_reference
@pytest.mark.data
@pytest.mark.parametrize("name", REAL)
def test_the_reference_reads_real_descriptions_as_we_do_and_each_feature_takes_its_value_back(name: str) -> None:
    findings = examine([name])[name]
    check(findings)
    assert findings["usable"] >= 30


FORMULAS = (
    "-2 ** 2", "-(2) ** 2", "2 ** 3 ** 2", "2 ** -2", "1 + 1 << 2", "8 >> 1 + 1", "2 - 1 << 1",
    "0 ** -1", "2 ** 64", "(-8) ** (1/3)", "ROUND(2.5)", "ROUND(-2.5)",
    "ROUND(2.345, 2)", "1 % 0", "-5 % 3", "5 % -3", "5.5 % 2", "LN(0)", "LN(-1)", "SQRT(-1)", "1 / LN(0)", "EXP(1000)",
    "1 / 0", "7 / 2", "-7 / 2", "0 ? 1/0 : 3", "1 ? 3 : 1/0", "0 && (1/0)", "1 ? 2 : 3 ? 4 : 5", "0 ? 2 : 0 ? 4 : 5",
    "1 ? (0 ? 7 : 8) : 9", "1 ? 0 ? 7 : 8 : 9", "!1", "1 == 1", "1 != 2", ".5",
    "5 & 3 = 1", "1 | 2 = 3", "3 | 4 ^ 1", "6 & 3 << 1", "1 || 0 && 0", "1 > 0 || 0 > 1", "1 = 3 > 2", "2 < 3 < 1",
    "1 << 4", "1 << 30", "8 >> 65", "-8 >> 1", "~5 & 0xFF", "~2 ** 2", "-5 & 0xFF", "2 * -3", "SGN(-3)", "NEG(3)",
    "ABS(-3)", "FRAC(2.5)", "TRUNC(-2.7)", "FLOOR(-2.5)", "CEIL(-2.5)", "PI", "E", "2 3", "", "3 +", "(3", "FOO(1)",
    "ROUND(1, 2, 3)", "10000000000 % 7", "9007199254740993 % 10",
)  # fmt: skip
WHOLE_ONLY = (
    "1 << 63", "1 << 64", "1 << 65", "9223372036854775807 + 1", "9223372036854775807 * 2", "2 ** 63", "0xFFFFFFFF",
    "0x80000000 >> 31", "0xF0000000 & 0xFF000000",
)  # fmt: skip
"""In formulas of floats the reference computes with 32 bits here; Aravis and we do not."""


@needs_reference
@pytest.mark.parametrize("integer", [False, True])
def test_formulas_mean_what_they_mean_to_the_reference(integer: bool) -> None:
    from tests.fake_camera.genapi.examiner import same, value_of_formula  # noqa: PLC0415 (needs the reference)

    differ = []
    for text in (*FORMULAS, *(WHOLE_ONLY if integer else ())):
        theirs = value_of_formula(text, integer)
        if integer and theirs == "error" and any(mark in text for mark in (".", "PI", "E")):
            continue  # neither floats nor constants in their integer formulas; taken by Aravis and us
        try:
            ours: Any = compile_formula(text, integer)({}.__getitem__)
        except (FormulaError, KeyError):
            ours = "error"
        if not same(ours, theirs):
            differ.append((text, ours, theirs))
    assert differ == []


NUMBERS = (
    *("ExposureTime", "ExposureTimeAbs", "ExposureTimeBaseAbs", "Gain", "GainAbs", "GainRaw", "Gamma"),
    *("Width", "Height", "OffsetX", "OffsetY", "AcquisitionFrameRate", "AcquisitionFrameRateAbs", "GevSCPSPacketSize"),
)
ALWAYS_0 = {"OffsetX", "OffsetY"}
"""While the image is as large as the sensor."""


@pytest.fixture(params=REAL)
def worn(request: pytest.FixtureRequest) -> Iterator[XmlCamera]:
    path = Path(request.param)
    with closing(Device(Ramp(), "X1")) as device:
        yield XmlCamera(Description.from_bytes(path.read_bytes(), path.name), device)


@pytest.mark.data
def test_there_are_descriptions() -> None:
    assert len(REAL) >= 55


@pytest.mark.data
def test_what_it_drives_has_limits_that_hold_its_value_and_a_smaller_image_has_room_to_move(worn: XmlCamera) -> None:
    camera = Evaluator(worn.description, worn)
    parts = [part for node in worn.description.nodes.values() for part in node.parts.get("pFeature", [])]
    offered = {(part.text or "").strip() for part in parts}
    there = [name for name in NUMBERS if name in offered and camera.kind(name) not in (None, "Category")]
    assert worn.not_available == ()
    assert {"Width", "Height"} < set(there)
    assert {"ExposureTime", "ExposureTimeAbs"} & set(there)
    for name in there:
        value, (low, high), step = camera.value(name), camera.limits(name), camera.bound(name, "Inc")
        assert low <= value <= high, name
        assert low < high or name in ALWAYS_0, name
        assert step is None or step > 0, name
        if step is not None and math.isfinite(low):
            assert abs((value - low) / step - round((value - low) / step)) < 1e-5, name
    for name in ("TriggerMode", "TriggerSource"):
        entries = {entry.integer("Value", 0) for entry in camera.node(name).entries.values()}
        assert camera.value(name) in entries
    for size, offset in (("Width", "OffsetX"), ("Height", "OffsetY")):
        camera.set(size, camera.limits(size)[0])
        assert camera.limits(offset)[1] > 0
