"""Descriptions of made-up cameras whose exposure, gain, rate or trigger is built in a way that a survey has found.

`tests.xml_cameras` has one description for each combination of features; here is how their nodes depend on each other,
and what is missing. The survey's 92 descriptions by these shapes: docs/look-up/dialects.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from tests.xml_cameras import Writer, chunk_control, document

Part = Callable[[Writer], None]


def _knife(writer: Writer, name: str, formula: str, integer: bool = False, **variables: str) -> None:
    """A node with the value of a formula; `variables` are the nodes behind its variables."""
    inside = "".join(f'<pVariable Name="{key}">{node}</pVariable>' for key, node in variables.items())
    kind = "IntSwissKnife" if integer else "SwissKnife"
    writer.nodes.append(f'<{kind} Name="{name}">{inside}<Formula>{formula}</Formula></{kind}>')


def _converter(writer: Writer, name: str, to: str, back: str, value: str, **variables: str) -> None:
    inside = "".join(f'<pVariable Name="{key}">{node}</pVariable>' for key, node in variables.items())
    writer.nodes.append(
        f'<Converter Name="{name}">{inside}<FormulaTo>{to}</FormulaTo><FormulaFrom>{back}</FormulaFrom>'
        f"<pValue>{value}</pValue><Slope>Varying</Slope></Converter>"
    )


def _feature(writer: Writer, kind: str, name: str, **parts: str) -> None:
    inside = "".join(f"<{tag}>{text}</{tag}>" for tag, text in parts.items())
    writer.nodes.append(f'<{kind} Name="{name}">{inside}</{kind}>')


# Exposure times


def counts_of_a_base(writer: Writer) -> None:
    """Raw counts of a time base; the limits of each follow from the other."""
    for register in ("TimeBase_Raw", "Longest_Raw", "ExposureTimeRaw_Raw"):
        writer.register("IntReg", register)
    _knife(writer, "ExposureTimeRaw_Max", "(BASE&gt;0)?(LONGEST/BASE):4095", BASE="TimeBase_us", LONGEST="Longest_Raw")
    _knife(writer, "TimeBase_Max", "(COUNT&gt;0)?(LONGEST/COUNT):100", COUNT="ExposureTimeRaw", LONGEST="Longest_Raw")
    _converter(writer, "TimeBase_us", "FROM*1000", "TO/1000", "TimeBase_Raw")
    conditions = writer.conditions("ExposureTimeBaseAbs")
    writer.nodes.append(
        f'<Float Name="ExposureTimeBaseAbs">{conditions}<pValue>TimeBase_us</pValue><Min>1</Min>'
        "<pMax>TimeBase_Max</pMax><Unit>us</Unit></Float>"
    )
    _feature(
        writer, "Integer", "ExposureTimeRaw", pValue="ExposureTimeRaw_Raw", Min="1", pMax="ExposureTimeRaw_Max", Inc="1"
    )  # fmt: skip


def time_over_a_base(writer: Writer) -> None:
    """As above, and a time in microseconds over both."""
    counts_of_a_base(writer)
    _converter(writer, "ExposureTime_Product", "FROM/BASE", "TO*BASE", "ExposureTimeRaw", BASE="ExposureTimeBaseAbs")
    _feature(writer, "Float", "ExposureTimeAbs", pValue="ExposureTime_Product", Unit="us")


def time_by_two_divisors(writer: Writer) -> None:
    """Lines of a length that follows from two divisors; what divides is read only once the time is not 0."""
    for register in ("Lines_Raw", "Clock_Raw", "Divider_Raw"):
        writer.register("IntReg", register)
    _knife(writer, "Line_us", "1000000/CLOCK+100/DIVIDER", CLOCK="Clock_Raw", DIVIDER="Divider_Raw")
    _converter(writer, "Lines_us", "FROM/LINE", "(TO=0)?0:(TO*LINE)", "Lines_Raw", LINE="Line_us")
    _knife(writer, "ExposureTime_Max", "1000*LINE*100", LINE="Line_us")
    _feature(writer, "Float", "ExposureTime", pValue="Lines_us", pMin="Line_us", pMax="ExposureTime_Max", Unit="us")


def whole_microseconds(writer: Writer) -> None:
    """An integer, locked unless the camera says that it has stopped."""
    for register in ("ExposureTime_Raw", "Stopped_Raw", "ExposureTimeMin_Raw", "ExposureTimeMax_Raw"):
        writer.register("IntReg", register)
    _knife(writer, "IsRunning", "STOPPED&lt;&gt;1", integer=True, STOPPED="Stopped_Raw")
    _knife(writer, "ExposureTime_Min", "LEAST", integer=True, LEAST="ExposureTimeMin_Raw")
    _knife(writer, "ExposureTime_Max", "MOST", integer=True, MOST="ExposureTimeMax_Raw")
    _feature(
        writer, "Integer", "ExposureTime", pIsLocked="IsRunning", pValue="ExposureTime_Raw", pMin="ExposureTime_Min",
        pMax="ExposureTime_Max", Inc="1",
    )  # fmt: skip


def plain_time(writer: Writer, name: str = "ExposureTime", unit: str = "us") -> None:
    writer.number(name, "Float", unit)


def counts_of_unknown_length(writer: Writer) -> None:
    writer.number("ExposureTimeRaw", "Integer", "")


def time_in_lines(writer: Writer) -> None:
    writer.number("ExposureTime", "Float", "lines")


def time_that_falls_as_its_register_rises(writer: Writer) -> None:
    """Limits in the register's own order, which the converter turns round."""
    writer.number("Speed", "Integer", "")
    writer.nodes.append(
        '<Converter Name="ExposureTime_Falling"><FormulaTo>1000000/FROM</FormulaTo><FormulaFrom>1000000/TO'
        "</FormulaFrom><pValue>Speed</pValue><Slope>Automatic</Slope></Converter>"
    )
    _feature(writer, "Float", "ExposureTime", pValue="ExposureTime_Falling", Unit="us")


def time_that_is_fixed(writer: Writer) -> None:
    _feature(writer, "Float", "ExposureTime", ImposedAccessMode="RO", Value="5000", Min="10", Max="1e5", Unit="us")


def time_beside_one_that_is_fixed(writer: Writer) -> None:
    time_that_is_fixed(writer)
    writer.number("ExposureTimeAbs", "Float", "us")


def time_within_bounds_of_no_number(writer: Writer) -> None:
    writer.register("FloatReg", "ExposureTime_Raw", length=8)
    _knife(writer, "ExposureTime_Max", "SQRT(0-1)")
    _feature(writer, "Float", "ExposureTime", pValue="ExposureTime_Raw", Min="10", pMax="ExposureTime_Max", Unit="us")


# What is automatic, or fixed


def _fixed(writer: Writer, name: str, entry: str, *others: str, selected: str | None = None) -> None:
    """An enumeration that is read-only and stands at `entry`."""
    entries = "".join(
        f'<EnumEntry Name="{each}"><Value>{number}</Value></EnumEntry>' for number, each in enumerate((entry, *others))
    )
    selects = "" if selected is None else f"<pSelected>{selected}</pSelected>"
    inside = f"<ImposedAccessMode>RO</ImposedAccessMode>{entries}<Value>0</Value>{selects}"
    writer.nodes.append(f'<Enumeration Name="{name}">{inside}</Enumeration>')


def fixed_as_needed(writer: Writer) -> None:
    """Nothing automatic, and all of it read-only."""
    for name, entry, other in (
        ("ExposureMode", "Timed", "TriggerWidth"),
        ("ExposureAuto", "Off", "Continuous"),
        ("GainAuto", "Off", "Continuous"),
        ("TriggerOverlap", "ReadOut", "Off"),
        ("TriggerActivation", "RisingEdge", "FallingEdge"),
    ):
        _fixed(writer, name, entry, other)
    _feature(writer, "Boolean", "GammaEnabled", ImposedAccessMode="RO", Value="0")
    _feature(writer, "Boolean", "AcquisitionFrameRateEnable", ImposedAccessMode="RO", Value="0")


def automatic_by_numbers(writer: Writer) -> None:
    """Switches that are no enumerations."""
    for kind, name in (("Integer", "GainAuto"), ("Boolean", "ExposureAuto"), ("Integer", "GammaEnable")):
        writer.register("IntReg", f"{name}_Raw")
        _feature(writer, kind, name, pValue=f"{name}_Raw")


def limited_rate(writer: Writer) -> None:
    plain_rate(writer)
    _feature(writer, "Boolean", "AcquisitionFrameRateEnable", ImposedAccessMode="RO", Value="1")


def fixed_rate(writer: Writer) -> None:
    _feature(
        writer, "Float", "AcquisitionFrameRate", ImposedAccessMode="RO", Value="25", Min="1", Max="60", Unit="Hz"
    )  # fmt: skip


def exposure_by_the_pulse(writer: Writer) -> None:
    plain_time(writer)
    _fixed(writer, "ExposureMode", "TriggerWidth", "Timed")


def always_automatic(writer: Writer) -> None:
    plain_time(writer)
    _fixed(writer, "ExposureAuto", "Continuous")


# Gain


def gain_in_db(writer: Writer) -> None:
    writer.number("Gain", "Float", "dB")


def raw_gain_of_taps(writer: Writer) -> None:
    """One raw gain for all, and one for each tap, in the same register."""
    writer.choice("GainSelector", {"Tap1": 1, "Tap2": 2, "All": 0}, ("GainRaw",))
    writer.number("GainRaw", "Integer", "")


def gain_of_a_fixed_selector(writer: Writer) -> None:
    """A selector that lists other entries, and never leaves this one: as on FLIR's Blackfly and Grasshopper3."""
    _fixed(writer, "GainSelector", "All", "DigitalAll", selected="Gain")
    gain_in_db(writer)


def gain_that_is_fixed(writer: Writer) -> None:
    _feature(writer, "Float", "Gain", ImposedAccessMode="RO", Value="0", Min="0", Max="24", Unit="dB")


def gain_within_bounds_of_no_number(writer: Writer) -> None:
    writer.register("FloatReg", "Gain_Raw", length=8)
    _knife(writer, "Gain_Max", "SQRT(0-1)")
    _feature(writer, "Float", "Gain", pValue="Gain_Raw", Min="0", pMax="Gain_Max", Unit="dB")


def gain_with_increments_of_zero(writer: Writer) -> None:
    """Raw, and of a selector without the entry All."""
    writer.choice("GainSelector", {"AnalogAll": 1, "DigitalAll": 2}, ("GainRaw",))
    writer.register("IntReg", "GainRaw_Raw")
    _feature(writer, "Integer", "GainRaw", pValue="GainRaw_Raw", Min="0", Max="240", Inc="0")


def gain_without_a_unit(writer: Writer) -> None:
    writer.choice("GainSelector", {"AnalogAll": 1, "All": 0, "DigitalAll": 2}, ("Gain",))
    writer.number("Gain", "Float", "")
    writer.nodes.append('<Integer Name="GainRaw"><pValue>GainRaw_Raw</pValue></Integer>')
    writer.register("IntReg", "GainRaw_Raw")


# Frame rates


def whole_rate(writer: Writer) -> None:
    writer.register("IntReg", "Rate_Raw")
    writer.register("IntReg", "RateMax_Raw", "RO")
    _knife(writer, "Rate_Max", "MOST", integer=True, MOST="RateMax_Raw")
    _feature(writer, "Integer", "AcquisitionFrameRate", pValue="Rate_Raw", Min="1", pMax="Rate_Max", Inc="1")


def plain_rate(writer: Writer) -> None:
    writer.number("AcquisitionFrameRate", "Float", "Hz")


def switched_rate(writer: Writer) -> None:
    """With a switch and an automatic mode."""
    plain_rate(writer)
    writer.choice("AcquisitionFrameRateAuto", {"Continuous": 2, "Off": 0})
    writer.register("IntReg", "RateEnabled_Raw")
    writer.nodes.append('<Boolean Name="AcquisitionFrameRateEnabled"><pValue>RateEnabled_Raw</pValue></Boolean>')


def rate_that_is_a_converter(writer: Writer) -> None:
    """The converter itself is the feature, over a period in us."""
    writer.number("Period_us", "Integer", "")
    writer.nodes.append(
        '<Converter Name="AcquisitionFrameRateAbs"><Extension><PvRename Name="ExposureMode"/></Extension>'
        "<FormulaTo>1000000/FROM</FormulaTo><FormulaFrom>1000000/TO</FormulaFrom><pValue>Period_us</pValue>"
        "<Slope>Decreasing</Slope></Converter>"
    )


# Triggers


def triggers(writer: Writer, *selectors: str, sources: tuple[str, ...] = ("Software", "Line1", "Line2")) -> None:
    """A trigger mode and source for each entry of a selector."""
    selected = ("TriggerMode", "TriggerSource")
    writer.choice("TriggerSelector", {name: number for number, name in enumerate(selectors)}, selected)
    writer.choice("TriggerMode", {"Off": 0, "On": 1})
    writer.choice("TriggerSource", {name: number for number, name in enumerate(sources)})


def frame_trigger(writer: Writer) -> None:
    triggers(writer, "FrameStart")


def edge_of_an_external_trigger(writer: Writer) -> None:
    """The edge can be chosen only while the source is a line and the exposure timed."""
    triggers(writer, "FrameStart")
    writer.choice("ExposureMode", {"TriggerWidth": 1, "Timed": 2})
    writer.register("IntReg", "Edge_Raw")
    _knife(
        writer, "Edge_Available", "((SOURCE=1)||(SOURCE=2))&amp;&amp;(MODE=2)", integer=True,
        SOURCE="TriggerSource_Raw", MODE="ExposureMode_Raw",
    )  # fmt: skip
    writer.nodes.append(
        '<Enumeration Name="TriggerActivation"><pIsAvailable>Edge_Available</pIsAvailable><EnumEntry Name="AnyEdge">'
        '<Value>2</Value></EnumEntry><EnumEntry Name="RisingEdge"><Value>0</Value></EnumEntry>'
        "<pValue>Edge_Raw</pValue></Enumeration>"
    )


def fixed_selector(writer: Writer, entry: str, other: str) -> None:
    """A TriggerSelector that stands where it stands, and may list more: as on Point Grey's Flea3."""
    _fixed(writer, "TriggerSelector", entry, other, selected="TriggerMode")
    writer.choice("TriggerMode", {"Off": 0, "On": 1})
    writer.choice("TriggerSource", {"Software": 0, "Line1": 1})


def trigger_without_a_selector(writer: Writer) -> None:
    """Its mode is a number."""
    writer.register("IntReg", "TriggerMode_Raw")
    _feature(writer, "Boolean", "TriggerMode", pValue="TriggerMode_Raw")
    writer.choice("TriggerSource", {"Software": 0, "Line1": 1})


def blanks_around_values(writer: Writer) -> None:
    """White space, as some editors leave it."""
    triggers(writer, "FrameStart")
    writer.register("IntReg", "TriggerSoftware_Raw", "WO")
    writer.nodes.append(
        '<Command Name="TriggerSoftware"><ImposedAccessMode> WO </ImposedAccessMode><pValue> TriggerSoftware_Raw '
        "</pValue><CommandValue> 1 </CommandValue></Command>"
    )
    writer.choice("ExposureAuto", {"Continuous": 2, "Off": 0}, extra="<ImposedAccessMode> RW </ImposedAccessMode>")


def sources_alone(writer: Writer) -> None:
    writer.choice("TriggerSource", {"Trigger": 0, "IO_Connector": 1})


# Pictures and time stamps


def picture(writer: Writer) -> None:
    """Sizes and offsets that limit each other."""
    for axis, size, offset in (("WIDTH", "Width", "OffsetX"), ("HEIGHT", "Height", "OffsetY")):
        for register in (f"{size}_Raw", f"{offset}_Raw", f"Sensor{size}_Raw"):
            writer.register("IntReg", register)
        _knife(writer, f"{size}_Max", "WHOLE-OFFSET", True, WHOLE=f"Sensor{size}_Raw", OFFSET=f"{offset}_Raw")
        _knife(writer, f"{offset}_Max", f"WHOLE-{axis}", True, WHOLE=f"Sensor{size}_Raw", **{axis: f"{size}_Raw"})
        _feature(writer, "Integer", f"Sensor{size}", pValue=f"Sensor{size}_Raw")
        _feature(writer, "Integer", size, pValue=f"{size}_Raw", Min="8", pMax=f"{size}_Max", Inc="4")
        _feature(writer, "Integer", offset, pValue=f"{offset}_Raw", Min="0", pMax=f"{offset}_Max")
    writer.register("IntReg", "PayloadSize_Raw", "RO")
    writer.nodes.append('<Integer Name="PayloadSize"><pValue>PayloadSize_Raw</pValue></Integer>')
    writer.choice("PixelFormat", {"Mono8": 0x01080001, "Mono16": 0x01100007})
    writer.choice("AcquisitionMode", {"Continuous": 0})
    writer.command("AcquisitionStart")
    writer.command("AcquisitionStop")


def picture_without_payload(writer: Writer) -> None:
    picture(writer)
    writer.nodes[:] = [node for node in writer.nodes if "PayloadSize" not in node]


def picture_without_start(writer: Writer) -> None:
    picture(writer)
    writer.nodes[:] = [node for node in writer.nodes if "AcquisitionSt" not in node]


def locked_picture(writer: Writer) -> None:
    """Locked while frames are sent, with formats and switches that exist only by name."""
    picture(writer)
    writer.nodes[:] = [node for node in writer.nodes if "PixelFormat" not in node]
    writer.register("IntReg", "TLParamsLocked_Raw")
    _feature(writer, "Integer", "TLParamsLocked", pValue="TLParamsLocked_Raw", Min="0", Max="1")
    writer.register("IntReg", "PixelFormat_Raw")
    writer.nodes.append('<Integer Name="Never_Available"><Value>0</Value></Integer>')
    writer.nodes.append(
        '<Enumeration Name="PixelFormat"><pIsLocked>TLParamsLocked</pIsLocked><EnumEntry Name="Mono16">'
        "<pIsAvailable>Never_Available</pIsAvailable><Value>0x01100007</Value></EnumEntry>"
        '<EnumEntry Name="Mono8"><Value>0x01080001</Value></EnumEntry><pValue>PixelFormat_Raw</pValue></Enumeration>'
    )
    _feature(writer, "Boolean", "GammaEnable", pIsAvailable="Never_Available", Value="1")


def latch_without_its_value(writer: Writer) -> None:
    writer.command("TimestampLatch")
    writer.register("IntReg", "Timestamp_Raw", "RO")
    writer.nodes.append('<Integer Name="Timestamp"><pValue>Timestamp_Raw</pValue></Integer>')


def chunks(writer: Writer) -> None:
    chunk_control(writer, {"ChunkExposureTime": ("Float", "us"), "ChunkGainAll": ("Integer", "")})


_lines = partial(triggers, sources=("Freerun", "Line1", "FixedRate", "Software"))

DRIVEN: dict[str, tuple[Part, ...]] = {
    "base": (picture, time_over_a_base, raw_gain_of_taps, plain_rate, frame_trigger),
    "counts": (picture, counts_of_a_base, plain_rate, frame_trigger),
    "divisors": (picture, time_by_two_divisors, gain_in_db, plain_rate, frame_trigger),
    "integers": (picture, whole_microseconds, whole_rate, edge_of_an_external_trigger),
    "converter": (
        picture, partial(plain_time, name="ExposureTimeAbs", unit=""), gain_without_a_unit, rate_that_is_a_converter,
        lambda w: _lines(w, "FrameStart", "AcquisitionStart", "AcquisitionEnd"),
    ),
    "exposure start": (
        picture, plain_time, gain_in_db, switched_rate, latch_without_its_value,
        lambda w: triggers(w, "ExposureStart", "ExposureActive"),
    ),
    "raw": (picture, plain_time, raw_gain_of_taps, switched_rate, chunks, frame_trigger),
    "only exposure start": (
        picture, plain_time, gain_without_a_unit, plain_rate, lambda w: triggers(w, "ExposureStart")
    ),
    "fixed selectors": (
        picture, plain_time, gain_of_a_fixed_selector, plain_rate,
        lambda w: fixed_selector(w, "ExposureStart", "ExposureActive"),
    ),
    "fixed as needed": (picture, plain_time, gain_in_db, fixed_as_needed, frame_trigger),
    "automatic by numbers": (
        picture, plain_time, gain_in_db, automatic_by_numbers, trigger_without_a_selector
    ),
    "blanks": (picture, plain_time, gain_in_db, blanks_around_values),
    "boundless gain": (picture, plain_time, gain_within_bounds_of_no_number, frame_trigger),
    "falling time": (picture, time_that_falls_as_its_register_rises, frame_trigger),
    "locked picture": (
        locked_picture, time_beside_one_that_is_fixed, gain_that_is_fixed, limited_rate,
        frame_trigger,
    ),
    "increments of zero": (picture, plain_time, gain_with_increments_of_zero, frame_trigger),
}  # fmt: skip
"""Cameras that are driven by a trigger line."""

COUNTED: dict[str, tuple[Part, ...]] = {
    "unknown counts": (picture, counts_of_unknown_length, gain_in_db, frame_trigger),
    "lines": (picture, time_in_lines, gain_in_db, frame_trigger),
}
"""Cameras that are driven once it is said what a count of their exposure time is."""

FREE_ONLY: dict[str, tuple[Part, ...]] = {
    "sources alone": (picture, plain_time, gain_without_a_unit, plain_rate, sources_alone),
    "acquisition start": (
        picture, time_over_a_base, raw_gain_of_taps, plain_rate, lambda w: triggers(w, "AcquisitionStart")
    ),
}  # fmt: skip
"""Cameras that can only run freely."""

REFUSED: dict[str, tuple[Part, ...]] = {
    "no exposure": (picture,),
    "a rate alone": (picture, plain_rate),
    "no picture": (plain_time,),
    "nothing": (),
    "a time alone": (picture, partial(plain_time, unit="s")),
    "fixed time": (picture, time_that_is_fixed, frame_trigger),
    "no bounds": (picture, time_within_bounds_of_no_number, frame_trigger),
    "by the pulse": (picture, exposure_by_the_pulse, frame_trigger),
    "always automatic": (picture, always_automatic, frame_trigger),
    "fixed at another trigger": (picture, plain_time, lambda w: fixed_selector(w, "AcquisitionStart", "FrameStart")),
    "no payload size": (picture_without_payload, plain_time, frame_trigger),
    "no start": (picture_without_start, plain_time, frame_trigger),
    "fixed rate": (picture, plain_time, fixed_rate),
}
"""What is not driven."""


def xml_shape(name: str, name_space: str = "GEV") -> bytes:
    """The description of a camera of that shape, and of the standard it names."""
    writer = Writer(0)
    for part in (DRIVEN | COUNTED | FREE_ONLY | REFUSED)[name]:
        part(writer)
    return document(name, name_space, writer.nodes)
