"""Formulas, nodes and registers; limits and conditions that are found in registers, whatever stands between."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from fake_camera.genapi.description import Description, NodeError
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.formula import FormulaError, compile_formula
from fake_camera.genapi.memory import Memory
from fake_camera.genapi.opener import Opener, Wished
from fake_camera.genapi.solve import achieve, assign, fill

BIG = "<pPort>Device</pPort><Endianess>BigEndian</Endianess>"
LITTLE = "<pPort>Device</pPort><Endianess>LittleEndian</Endianess>"


def camera(*nodes: str, memory: Memory | None = None) -> Evaluator:
    text = (
        f'<?xml version="1.0"?><RegisterDescription ModelName="M" VendorName="V">{"".join(nodes)}</RegisterDescription>'
    )
    return Evaluator(Description.from_bytes(text.encode(), "test"), memory or Memory())


def formula(text: str, integer: bool = False, **variables: float) -> float:
    values: Mapping[str, float] = variables
    return compile_formula(text, integer)(values.__getitem__)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3 - 4", 3), ("(1 + 2) * 3", 9), ("2 ** 3 ** 2", 64), ("-2 ** 2", 4), ("-(2) ** 2", -4), ("7 % 4", 3),
        ("0x10 | 1", 17), ("6 & 3", 2), ("6 ^ 3", 5), ("1 << 4 >> 2", 4), ("~0 & 0xFF", 255),
        ("1 + 1 << 2", 5), ("6 & 3 << 1", 4),
        ("1 = 1", 1), ("1 <> 1", 0), ("2 >= 2 && 1 < 2", 1), ("0 || 0", 0), ("0?2:0?3:4", 4),
        ("1 ? 2 : (0 ? 3 : 4)", 2),
        ("1 ? 2 : 3 ? 4 : 5", 4), ("5 & 3 = 1", 1), ("1 > 0 || 0 > 1", 0),
        ("EXP(LN(5))", 5), ("LG(1000)", 3), ("SQRT(16) + ABS(-1)", 5), ("SGN(-3) + TRUNC(2.9) + CEIL(0.1)", 2),
        ("1.5e1 + 0.5", 15.5), ("7 / 2", 3.5),
        ("ROUND(2.5) + ROUND(-2.5)", 0), ("ROUND(2.345, 2)", 2.35),
        ("LN(0)", -math.inf), ("2.0e-3", 0.002), ("PI", math.pi), ("A.B * C_1", 6),
    ],
)  # fmt: skip
def test_formulas(text: str, value: float) -> None:
    assert formula(text, **{"A.B": 2, "C_1": 3}) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "value"),
    [("7 / 2", 3), ("-7 / 2", -3), ("1 << 63", -(1 << 63)), ("1 << 64", 1), ("9223372036854775807 + 1", -(1 << 63)),
     ("9007199254740993 % 10", 3)],
)  # fmt: skip
def test_integer_formulas_have_64_bits_and_divide_towards_zero(text: str, value: int) -> None:
    assert formula(text, integer=True) == value


@pytest.mark.parametrize(
    "text",
    ["1 +", "(1", "1 ? 2", "FOO(1)", "1 2", "", "!1", "1 == 1", "1 != 2", ".5", "SIN(1, 2)", "1 / 0", "1 % 0",
     "0 ? 1 / 0 : 3"],
)  # fmt: skip
def test_what_is_no_formula_or_has_no_value_is_refused(text: str) -> None:
    with pytest.raises(FormulaError):
        formula(text)


def test_bits_count_from_the_top_when_big_endian_and_from_the_bottom_when_little() -> None:
    memory = Memory()
    memory.write(0x10, bytes.fromhex("80000003"))
    for name, parts, value in (
        ("top", f"<Bit>0</Bit>{BIG}", 1), ("low", f"<LSB>31</LSB><MSB>30</MSB>{BIG}", 3),
        ("little", f"<LSB>0</LSB><MSB>7</MSB>{LITTLE}", 0x80),
        ("negative", f"<LSB>31</LSB><MSB>30</MSB><Sign>Signed</Sign>{BIG}", -1),
    ):  # fmt: skip
        node = f'<MaskedIntReg Name="{name}"><Address>0x10</Address><Length>4</Length>{parts}</MaskedIntReg>'
        evaluator = camera(node, memory=memory)
        assert evaluator.value(name) == value
    evaluator.set("negative", 1)
    assert memory.read(0x10, 4) == bytes.fromhex("80000001")


def test_addresses_are_sums_and_indices() -> None:
    evaluator = camera(
        '<Integer Name="Base"><Value>0x100</Value></Integer>',
        '<Integer Name="Index"><Value>2</Value></Integer>',
        '<IntReg Name="Indexed"><Address>0x10</Address><pAddress>Base</pAddress>'
        f'<pIndex Offset="0x20">Index</pIndex>{BIG}</IntReg>',
        f'<IntReg Name="Computed"><Address>4</Address><IntSwissKnife Name="X"><pVariable Name="I">Index</pVariable>'
        f"<Formula>I*8</Formula></IntSwissKnife>{BIG}</IntReg>",
    )
    assert evaluator.field("Indexed").address == 0x150
    assert evaluator.field("Computed").address == 20
    with evaluator.selecting("Index", 0):
        assert evaluator.field("Indexed").address == 0x110


def test_struct_entries_share_a_register_and_indexed_values_choose_theirs() -> None:
    memory = Memory()
    evaluator = camera(
        f"<StructReg><Address>0x20</Address><Length>4</Length>{LITTLE}"
        '<StructEntry Name="Here"><Bit>0</Bit></StructEntry><StructEntry Name="There"><Bit>1</Bit></StructEntry>'
        "</StructReg>",
        '<Integer Name="Choice"><Value>1</Value></Integer>',
        '<Integer Name="Chosen"><pIndex>Choice</pIndex><pValueIndexed Index="0">Here</pValueIndexed>'
        '<pValueIndexed Index="1">There</pValueIndexed><pValueDefault>Here</pValueDefault></Integer>',
        memory=memory,
    )
    evaluator.set("Chosen", 1)
    assert (evaluator.value("Here"), evaluator.value("There")) == (0, 1)
    assert memory.read(0x20, 4) == b"\x02\0\0\0"


def test_converters_go_both_ways_and_carry_limits() -> None:
    evaluator = camera(
        '<Float Name="Gain"><pValue>dB</pValue></Float>',
        '<Converter Name="dB"><FormulaTo>EXP(FROM/20*LN(10))*256</FormulaTo><FormulaFrom>20*LG(TO/256)</FormulaFrom>'
        "<pValue>Factor</pValue></Converter>",
        '<Integer Name="Factor"><pValue>Raw</pValue><Min>256</Min><Max>2560</Max></Integer>',
        f'<IntReg Name="Raw"><Address>0</Address>{BIG}</IntReg>',
    )
    evaluator.set("Gain", 6.0)
    assert evaluator.value("Raw") == 511
    assert evaluator.value("Gain") == pytest.approx(6.0, abs=0.02)
    assert evaluator.bound("Gain", "Min") == 0.0
    assert evaluator.bound("Gain", "Max") == pytest.approx(20.0)


def test_circles_and_missing_nodes_are_told() -> None:
    evaluator = camera('<Integer Name="A"><pValue>B</pValue></Integer><Integer Name="B"><pValue>A</pValue></Integer>')
    with pytest.raises(NodeError, match="depends on itself"):
        evaluator.value("A")
    with pytest.raises(NodeError, match="no node C"):
        evaluator.value("C")


REGISTERS = "".join(f'<IntReg Name="R{n}"><Address>{4 * n}</Address>{BIG}</IntReg>' for n in range(3))


def knife(text: str, *registers: str) -> Evaluator:
    variables = "".join(f'<pVariable Name="{name}">{name}</pVariable>' for name in registers)
    return camera(REGISTERS, f'<SwissKnife Name="K">{variables}<Formula>{text}</Formula></SwissKnife>')


@pytest.mark.parametrize(
    ("text", "registers", "value"),
    [
        ("R0 * 6.02 / (2**14)", ("R0",), 24.0),
        ("(R0 &lt;&lt; 32) | R1", ("R0", "R1"), 0x123456789A),
        ("R0 - R1 + 10", ("R0", "R1"), 730),
        ("1e6 / R0", ("R0",), 200.0),
        ("(R0 = 0) ? 0 : 1000 / R1", ("R0", "R1"), 20.0),  # one that matters only at times
        ("R0 * ((R0 &gt; 0) ? R1 : 0)", ("R0", "R1"), 24.0),
    ],
)
def test_registers_are_found_that_give_a_value(text: str, registers: tuple[str, ...], value: float) -> None:
    evaluator = knife(text, *registers)
    assign(evaluator, "K", value)
    assert evaluator.value("K") == pytest.approx(value, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "registers"),
    [
        ("(R0 &amp; 0x40000000) &gt;&gt; 30", ("R0",)),
        ("R0 = 17", ("R0",)),
        ("R0 &amp;&amp; (R1 || R2)", ("R0", "R1", "R2")),
    ],
)
def test_conditions_are_made_true_without_breaking_earlier_ones(text: str, registers: tuple[str, ...]) -> None:
    evaluator = knife(text, *registers)
    unlocked = lambda: not int(evaluator.value("R0")) & 0x10000000  # noqa: E731
    assert achieve(evaluator, lambda: bool(evaluator.value("K")), "K", {0: [unlocked]})
    assert evaluator.value("K") and unlocked()


def test_what_cannot_be_achieved_leaves_the_registers_alone() -> None:
    evaluator = knife("R0 * 0", "R0")
    assert not achieve(evaluator, lambda: bool(evaluator.value("K")), "K", {})
    assert evaluator.value("R0") == 0


def test_filling_goes_on_to_what_the_first_registers_hid() -> None:
    evaluator = knife("1 / R0 + 1 / R1", "R0", "R1", "R2")
    assert fill(evaluator, ("K",), 4) == ["R0", "R1"]
    assert evaluator.value("K") == 0.5


@pytest.mark.parametrize(
    ("namespace", "order", "feature", "standard"),
    [
        ("GEV", "LittleEndian", "R", "GEV"),
        ("USB", "BigEndian", "R", "U3V"),
        ("U3V", "BigEndian", "R", "U3V"),
        ("None", "LittleEndian", "GevSCPSPacketSize", "U3V"),  # as Allied Vision's USB3 cameras
        ("None", "BigEndian", "GevSCPSPacketSize", "GEV"),
        ("None", "BigEndian", "R", None),
    ],
)
def test_its_standard_or_its_registers_tell_the_wire(
    namespace: str, order: str, feature: str, standard: str | None
) -> None:
    text = (
        f'<RegisterDescription ModelName="M" VendorName="V" StandardNameSpace="{namespace}"><IntReg Name="{feature}">'
        f"<Address>0</Address><pPort>Device</pPort><Endianess>{order}</Endianess></IntReg></RegisterDescription>"
    )
    assert Description.from_bytes(text.encode(), "").standard == standard


@pytest.mark.parametrize("declaration", ['<?xml version="1.0"?>', ""])
def test_text_before_a_description_is_left_out(declaration: str) -> None:
    text = f'Camera of Nobody (USB3)\n{declaration}<RegisterDescription ModelName="M" VendorName="V"/>'
    description = Description.from_bytes(text.encode(), "")
    assert (description.vendor, description.model) == ("V", "M")
    assert description.data.startswith(declaration.encode() or b"<RegisterDescription")


@pytest.mark.parametrize(("text", "words"), [(b"hello", "not an XML file"), (b"<html/>", "this one with html")])
def test_what_is_no_description_is_refused_in_one_sentence(text: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=f"some.xml: .*{words}"):
        Description.from_bytes(text, "some.xml")


TIME = Wished(10, 1e6, 1, 5000)


def register(name: str, address: int, length: int = 4) -> str:
    return f'<IntReg Name="{name}"><Address>{address}</Address><Length>{length}</Length>{BIG}</IntReg>'


def whole_knife(name: str, formula: str, **variables: str) -> str:
    inside = "".join(f'<pVariable Name="{key}">{node}</pVariable>' for key, node in variables.items())
    return f'<IntSwissKnife Name="{name}">{inside}<Formula>{formula}</Formula></IntSwissKnife>'


def number(name: str, **parts: str) -> str:
    return f'<Integer Name="{name}">{"".join(f"<{tag}>{text}</{tag}>" for tag, text in parts.items())}</Integer>'


def test_both_limits_in_one_register() -> None:
    evaluator = camera(
        register("Inquiry", 0), register("Raw", 4),
        whole_knife("Least", "(INQ &gt;&gt; 12) &amp; 0xFFF", INQ="Inquiry"),
        whole_knife("Most", "INQ &amp; 0xFFF", INQ="Inquiry"),
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
        whole_knife("Most", "(MAX % UNIT) ? (MAX - MAX % UNIT) : MAX", MAX="Whole", UNIT="Unit"),
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
        whole_knife("Ready", "(C &amp; 0x40000000) &gt;&gt; 30", C="Conditions"),
        whole_knife("Locked", "(C &amp; 0x10000000) &gt;&gt; 28", C="Conditions"),
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
        whole_knife("Ready", "(MODE = 1) &amp;&amp; ENABLED", MODE="TriggerMode", ENABLED="Enabled"),
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
        camera(register("Unit", 0), whole_knife("K", "5 % UNIT", UNIT="Unit")).value("K")
