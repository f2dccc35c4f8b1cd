"""Limits, increments and conditions that are found in registers, whatever stands between."""

from __future__ import annotations

import pytest

from fake_camera.genapi.opener import Opener, Wished
from tests.fake_camera.genapi.test_genapi import BIG, camera

TIME = Wished(10, 1e6, 1, 5000)


def register(name: str, address: int, length: int = 4) -> str:
    return f'<IntReg Name="{name}"><Address>{address}</Address><Length>{length}</Length>{BIG}</IntReg>'


def knife(name: str, formula: str, **variables: str) -> str:
    inside = "".join(f'<pVariable Name="{key}">{node}</pVariable>' for key, node in variables.items())
    return f'<IntSwissKnife Name="{name}">{inside}<Formula>{formula}</Formula></IntSwissKnife>'


def number(name: str, **parts: str) -> str:
    return f'<Integer Name="{name}">{"".join(f"<{tag}>{text}</{tag}>" for tag, text in parts.items())}</Integer>'


def test_both_limits_in_one_register() -> None:
    evaluator = camera(
        register("Inquiry", 0), register("Raw", 4),
        knife("Least", "(INQ &gt;&gt; 12) &amp; 0xFFF", INQ="Inquiry"), knife("Most", "INQ &amp; 0xFFF", INQ="Inquiry"),
        number("GainRaw", pValue="Raw", pMin="Least", pMax="Most"),
    )  # fmt: skip
    opener = Opener(evaluator)
    opener.number("GainRaw", Wished(16, 680, 1, 16))
    assert opener.failed == []
    assert (evaluator.limits("GainRaw"), evaluator.value("GainRaw")) == ((16, 680), 16)


def test_a_base_stays_within_its_own_limits() -> None:
    evaluator = camera(
        register("Base", 0), register("Raw", 4), register("RawMax", 8),
        number("TimeBase", pValue="Base", Min="1", Max="100"),
        number("Counts", pValue="Raw", Min="1", pMax="RawMax"),
        '<Float Name="Time"><pValue>Product</pValue></Float>',
        '<Converter Name="Product"><pVariable Name="BASE">TimeBase</pVariable><FormulaTo>FROM/BASE</FormulaTo>'
        "<FormulaFrom>TO*BASE</FormulaFrom><pValue>Counts</pValue><Slope>Increasing</Slope></Converter>",
    )  # fmt: skip
    Opener(evaluator).number("Time", TIME)
    low, high = evaluator.limits("Time")
    assert 1 <= evaluator.value("TimeBase") <= 100
    assert low < evaluator.value("Time") == 5000 < high


def test_a_minimum_is_a_multiple_of_the_increment_and_a_value_is_on_it() -> None:
    for limits, value in (({"pMin": "RawMin"}, 720), ({"Min": "8"}, 704)):
        width = number("Width", pValue="Raw", **limits, Max="720", Inc="24")
        evaluator = camera(register("Raw", 0), register("RawMin", 4), width)
        Opener(evaluator).number("Width", Wished(8, 720, 4, 720))
        assert evaluator.value("Width") == value
        assert evaluator.value("RawMin") == (24 if "pMin" in limits else 0)


def test_an_increment_that_a_limit_is_divided_by_is_filled_first() -> None:
    evaluator = camera(
        register("Raw", 0), register("Unit", 4), register("Whole", 8),
        knife("Most", "(MAX % UNIT) ? (MAX - MAX % UNIT) : MAX", MAX="Whole", UNIT="Unit"),
        number("Width", pValue="Raw", pMin="Unit", pMax="Most", pInc="Unit"),
    )  # fmt: skip
    Opener(evaluator).number("Width", Wished(8, 720, 4, 720))
    assert [evaluator.bound("Width", which) for which in ("Min", "Max", "Inc")] == [4, 720, 4]
    assert evaluator.value("Width") == 720


def test_a_falling_converter_swaps_limits() -> None:
    evaluator = camera(
        register("Raw", 0), register("RawMin", 4), register("RawMax", 8),
        number("Period_us", pValue="Raw", pMin="RawMin", pMax="RawMax"),
        '<Converter Name="Rate"><FormulaTo>1000000/FROM</FormulaTo><FormulaFrom>1000000/TO</FormulaFrom>'
        "<pValue>Period_us</pValue><Slope>Decreasing</Slope></Converter>",
    )  # fmt: skip
    Opener(evaluator).number("Rate", Wished(1, 200, 0.01, 50))
    assert evaluator.limits("Rate") == (1, 200)
    assert evaluator.value("Rate") == 50


def test_two_conditions_in_one_register_are_met_one_after_the_other() -> None:
    bit = '<MaskedIntReg Name="{}"><Address>0</Address><Length>4</Length><Bit>{}</Bit>{}</MaskedIntReg>'
    evaluator = camera(
        bit.format("There", 0, BIG), register("Conditions", 0), register("Raw", 4),
        knife("Ready", "(C &amp; 0x40000000) &gt;&gt; 30", C="Conditions"),
        knife("Locked", "(C &amp; 0x10000000) &gt;&gt; 28", C="Conditions"),
        "<Integer Name='Gain'><pIsImplemented>There</pIsImplemented><pIsAvailable>Ready</pIsAvailable>"
        "<pIsLocked>Locked</pIsLocked><pValue>Raw</pValue></Integer>".replace("'", '"'),
    )  # fmt: skip
    opener = Opener(evaluator)
    assert opener.open("Gain")
    assert [evaluator.value(name) for name in ("There", "Ready", "Locked")] == [1, 1, 0]


def test_what_exists_only_in_another_state_is_opened_for_it() -> None:
    evaluator = camera(
        register("Mode", 0), register("Enabled", 4), register("Raw", 8),
        '<Enumeration Name="TriggerMode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry><EnumEntry Name="On">'
        "<Value>1</Value></EnumEntry><pValue>Mode</pValue></Enumeration>",
        knife("Ready", "(MODE = 1) &amp;&amp; ENABLED", MODE="TriggerMode", ENABLED="Enabled"),
        '<Command Name="TriggerSoftware"><pIsAvailable>Ready</pIsAvailable><pValue>Raw</pValue>'
        "<CommandValue>1</CommandValue></Command>",
    )  # fmt: skip
    opener = Opener(evaluator)
    with opener.selecting("TriggerMode", "On", now=False):
        opener.command("TriggerSoftware")
    assert (opener.failed, evaluator.value("Mode"), evaluator.value("Ready")) == ([], 0, 0)
    evaluator.set("TriggerMode", 1)
    assert evaluator.value("Ready") == 1


def test_a_formula_has_no_remainder_of_zero() -> None:
    with pytest.raises(ValueError, match="zero"):
        camera(register("Unit", 0), knife("K", "5 % UNIT", UNIT="Unit")).value("K")
