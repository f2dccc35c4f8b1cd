"""Tiny GenICam descriptions, one for each combination of dialects seen in the field, for cameras nobody sells."""

from __future__ import annotations

from collections.abc import Iterator

REAL = {
    "gige": ("AVT_Mako_G125B", "Basler-a2A2600-20gmBAS", "Basler-acA1300-60gm", "FLIR_BFS_PGE_88S6M"),
    "usb3": ("Allied_Vision_1800_U-811m", "PGR_BlackflyS_16S2M"),
}
"""Descriptions of real cameras by their transport; they are not ours to ship, see tests/data.py."""

COMBINATIONS = (
    "",
    "ExposureTimeAbs=Float GainRaw=Integer TriggerOverlap ChunkModeActive",
    "ExposureTimeAbs=Float Gain=Category GainRaw=Float TriggerOverlap ChunkModeActive",
    "ExposureTimeAbs=Float Gain=Category GainRaw=Integer TriggerOverlap ChunkModeActive",
    "ExposureTimeAbs=Float Gain=Float TriggerOverlap ChunkModeActive",
    "ExposureTimeAbs=Float Gain=Float GainRaw=Integer TriggerOverlap ChunkModeActive",
    "ExposureTimeAbs=Float:us ExposureTimeRaw=Integer GainRaw=Integer ChunkModeActive ChunkExposureTime=Float "
    "ChunkFramecounter=Integer",
    "ExposureTimeAbs=Float:us ExposureTimeRaw=Integer GainRaw=Integer ChunkModeActive ChunkExposureTime=Float "
    "ChunkGainAll=Integer ChunkFramecounter=Integer",
    "ExposureTimeAbs=Float:us ExposureTimeRaw=Integer ExposureTimeBaseAbs=Float:us GainRaw=Integer ChunkModeActive "
    "ChunkFramecounter=Integer",
    "ExposureTimeAbs=Float:us ExposureTimeRaw=Integer ExposureTimeBaseAbs=Float:us GainRaw=Integer ChunkModeActive "
    "ChunkExposureTime=Float ChunkFramecounter=Integer",
    "ExposureTime=Float",
    "ExposureTime=Float:s",
    "ExposureTime=Float:us Gain=Float",
    "ExposureTime=Float:us Gain=Float:dB",
    "ExposureTime=Float:us Gain=Float:dB ChunkModeActive ChunkExposureTime=Float:us ChunkGain=Float:dB "
    "ChunkFrameID=Integer",
    "ExposureTime=Float:us ExposureTimeRaw=Integer Gain=Float GainRaw=Integer",
    "ExposureTime=Float:us ExposureTimeRaw=Integer Gain=Float:dB GainRaw=Integer TriggerOverlap ChunkModeActive "
    "ChunkExposureTime=Float:us ChunkGain=Float:dB ChunkFrameID=Integer",
    "ExposureTime=Float:us ExposureTimeAbs=Float:us Gain=Float:dB TriggerOverlap ChunkModeActive "
    "ChunkExposureTime=Float ChunkGain=Float ChunkFrameCounter=Integer",
    "ExposureTime=Float:µs Gain=Float:dB",
    "ExposureTime=Integer",
)
"""What 92 descriptions of 5 vendors declare of exposure time, gain, overlap and chunks, each combination once, in the
order of the table that lists them; a feature with its type and unit."""


SCALE = 16
"""Counts in a unit, where numbers are converted."""


class Writer:
    """Writes nodes in one of three ways, as vendors do.

    Way 0: big-endian floats, nothing conditional. Way 1: big-endian integers behind converters, limits behind
    SwissKnives, conditions in bits. Way 2: little-endian, conditions in a StructReg, registers by pAddress.
    """

    def __init__(self, way: int) -> None:
        self._way = way
        self._at = 0x20000
        self._order = "LittleEndian" if way == 2 else "BigEndian"
        self.nodes: list[str] = []

    @property
    def converts(self) -> bool:
        """Whether numbers lie behind converters."""
        return self._way == 1

    def register(self, kind: str, name: str, access: str = "RW", length: int = 4, extra: str = "") -> None:
        """A register at an address of its own."""
        where = f"<Address>0x{self._at:X}</Address>"
        if self._way == 2:
            self.nodes.append(f'<Integer Name="{name}_At"><Value>{self._at}</Value></Integer>')
            where = f"<pAddress>{name}_At</pAddress>"
        self._at += 0x10
        self.place(kind, name, where, access, length=length, bits=extra)

    def place(
        self, kind: str, name: str, where: str, access: str, *, port: str = "Device", length: int = 4, bits: str = ""
    ) -> None:
        """A register at an address, in the order that the schema of GenApi demands; with `bits` only some of it."""
        below, attribute = ("", "Name") if kind != "StructReg" else (bits, "Comment")
        self.nodes.append(
            f'<{kind} {attribute}="{name}">{where}<Length>{length}</Length><AccessMode>{access}</AccessMode>'
            f"<pPort>{port}</pPort><Cachable>NoCache</Cachable>{'' if below else bits}"
            f"<Endianess>{self._order}</Endianess>{below}</{kind}>"
        )

    def conditions(self, name: str) -> str:
        """Elements that make a feature conditional, and the registers behind them."""
        if self._way == 0:
            return ""
        bits = {"Implemented": 0, "Available": 1, "Locked": 3}
        where = f"<Address>0x{self._at:X}</Address>"
        self._at += 0x10
        if self._way == 1:
            for what, bit in bits.items():
                self.place("MaskedIntReg", f"{name}_{what}", where, "RO", bits=f"<Bit>{bit}</Bit>")
        else:
            entry = '<StructEntry Name="{}_{}"><Bit>{}</Bit></StructEntry>'
            entries = "".join(entry.format(name, what, bit) for what, bit in bits.items())
            self.place("StructReg", f"{name}_Inquiry", where, "RO", bits=entries)
        return "".join(f"<pIs{what}>{name}_{what}</pIs{what}>" for what in bits)

    def number(self, name: str, type_: str, unit: str) -> None:
        """A number whose value and limits lie in registers."""
        conditions = self.conditions(name)
        floats = type_ == "Float" and self._way != 1
        kind, length = ("FloatReg", 8 if self._way == 0 else 4) if floats else ("IntReg", 4)
        parts = {"pValue": f"{name}_Raw", "pMin": f"{name}_RawMin", "pMax": f"{name}_RawMax"}
        for part, register in parts.items():
            self.register(kind, register, "RW" if part == "pValue" else "RO", length)
        if type_ == "Float" and self._way == 1:
            parts = {part: self._scaled(register, part == "pValue") for part, register in parts.items()}
        inside = "".join(f"<{part}>{register}</{part}>" for part, register in parts.items())
        unit = f"<Unit>{unit}</Unit>" if unit else ""
        self.nodes.append(f'<{type_} Name="{name}">{conditions}{inside}{unit}</{type_}>')

    def _scaled(self, register: str, writable: bool) -> str:
        """The node that reads a register in counts of 1/`SCALE`."""
        if writable:
            self.nodes.append(
                f'<Converter Name="{register}_Scaled"><FormulaTo>FROM*{SCALE}</FormulaTo><FormulaFrom>TO/{SCALE}'
                f"</FormulaFrom><pValue>{register}</pValue><Slope>Increasing</Slope></Converter>"
            )
        else:
            self.nodes.append(
                f'<SwissKnife Name="{register}_Scaled"><pVariable Name="RAW">{register}</pVariable>'
                f"<Formula>(RAW&lt;&gt;0)?(RAW/{SCALE}):0</Formula></SwissKnife>"
            )
        return f"{register}_Scaled"

    def choice(self, name: str, entries: dict[str, int], selects: tuple[str, ...] = (), extra: str = "") -> None:
        """An enumeration in a register."""
        conditions = extra + self.conditions(name)
        entry = '<EnumEntry Name="{}"><Value>{}</Value></EnumEntry>'
        inside = "".join(entry.format(*item) for item in entries.items()) + f"<pValue>{name}_Raw</pValue>"
        inside += "".join(f"<pSelected>{selected}</pSelected>" for selected in selects)
        self.register("IntReg", f"{name}_Raw")
        self.nodes.append(f'<Enumeration Name="{name}">{conditions}{inside}</Enumeration>')

    def command(self, name: str, value: int = 1) -> None:
        self.register("IntReg", f"{name}_Raw", "WO")
        self.nodes.append(
            f'<Command Name="{name}"><pValue>{name}_Raw</pValue><CommandValue>{value}</CommandValue></Command>'
        )

    def chunk(self, name: str, type_: str, unit: str, chunk_id: int) -> None:
        """A number in the chunk data."""
        floats = type_ == "Float" and self._way == 0
        value = f"{name}_Raw"
        self.place("FloatReg" if floats else "IntReg", value, "<Address>0x0</Address>", "RO", port=f"{name}_Port")
        if type_ == "Float" and not floats:
            value = self._scaled(value, False)
        unit = f"<Unit>{unit}</Unit>" if unit else ""
        self.nodes.append(f'<{type_} Name="{name}"><pValue>{value}</pValue>{unit}</{type_}>')
        self.nodes.append(f'<Port Name="{name}_Port"><ChunkID>{chunk_id:X}</ChunkID></Port>')


def features(combination: str) -> dict[str, tuple[str, str]]:
    """Type and unit of each feature that a combination names."""
    found = {}
    for token in combination.split():
        name, _, declared = token.partition("=")
        type_, _, unit = declared.partition(":")
        found[name] = type_, unit
    return found


def xml_camera(number: int, name_space: str = "GEV", *, ptp: bool = False) -> bytes:
    """The description of the camera with the `number`-th combination, of the standard it names, and with PTP or not."""
    declared = features(COMBINATIONS[number])
    writer = Writer(number % 3)
    for name, (type_, unit) in declared.items():
        if type_ in ("Integer", "Float") and not name.startswith("Chunk"):
            writer.number(name, type_, unit)
    if declared.get("Gain", ("", ""))[0] == "Category":
        writer.nodes.append('<Category Name="Gain"><pFeature>GainRaw</pFeature></Category>')
    _everything_else(writer, declared)
    if ptp:
        _ptp_and_actions(writer)
    return document(f"Tiny{number}", name_space, writer.nodes)


def _everything_else(writer: Writer, declared: dict[str, tuple[str, str]]) -> None:
    for name in ("Width", "Height", "OffsetX", "OffsetY"):
        writer.number(name, "Integer", "")
    writer.register("IntReg", "PayloadSize_Raw", "RO")
    writer.nodes.append('<Integer Name="PayloadSize"><pValue>PayloadSize_Raw</pValue></Integer>')
    if writer.converts:
        _lookup_and_period(writer)
    else:
        writer.choice("PixelFormat", {"Mono8": 0x01080001, "Mono10": 0x01100003})
        writer.number("AcquisitionFrameRate", "Float", "Hz")
    writer.choice("AcquisitionMode", {"Continuous": 2, "SingleFrame": 0})
    writer.choice("ExposureAuto", {"Off": 0, "Continuous": 2})
    writer.choice("TriggerSelector", {"AcquisitionStart": 0, "FrameStart": 1}, ("TriggerMode", "TriggerSource"))
    writer.choice("TriggerMode", {"Off": 0, "On": 1})
    writer.choice("TriggerSource", {"Software": 0, "Line1": 1, "Line2": 2, "Action0": 7})
    if "TriggerOverlap" in declared:
        writer.choice("TriggerOverlap", {"Off": 0, "ReadOut": 1})
    writer.command("AcquisitionStart")
    writer.command("AcquisitionStop", 0)
    if "ChunkModeActive" in declared:
        chunk_control(writer, declared)


def _ptp_and_actions(writer: Writer) -> None:
    writer.register("IntReg", "PtpEnable_Raw")
    writer.nodes.append('<Boolean Name="PtpEnable"><pValue>PtpEnable_Raw</pValue></Boolean>')
    writer.choice("PtpStatus", {"Disabled": 2, "Initializing": 0, "Slave": 8})
    writer.choice("PtpServoStatus", {"Locked": 6, "Idle": 5})
    for name in ("PtpOffsetFromMaster", "PtpClockID", "ActionDeviceKey"):
        writer.register("IntReg", f"{name}_Raw", length=8)
        writer.nodes.append(f'<Integer Name="{name}"><pValue>{name}_Raw</pValue></Integer>')
    writer.command("PtpDataSetLatch", 0)


def _lookup_and_period(writer: Writer) -> None:
    """Pixel formats behind a lookup table, and a frame rate over a register that holds a period: as on Basler's ace."""
    writer.register("IntReg", "PixelFormat_Raw")
    writer.nodes.append(
        '<IntConverter Name="PixelFormat_Lookup"><FormulaTo>(FROM=0x01080001)?1:((FROM=0x01100003)?3:0xFFFFFFFF)'
        "</FormulaTo><FormulaFrom>(TO=1)?0x01080001:((TO=3)?0x01100003:0xFFFFFFFF)</FormulaFrom>"
        "<pValue>PixelFormat_Raw</pValue><Slope>Varying</Slope></IntConverter>"
    )
    writer.nodes.append(
        '<Enumeration Name="PixelFormat"><EnumEntry Name="Mono8"><Value>0x01080001</Value></EnumEntry>'
        '<EnumEntry Name="Mono10"><Value>0x01100003</Value></EnumEntry><pValue>PixelFormat_Lookup</pValue>'
        "</Enumeration>"
    )
    writer.register("IntReg", "TimeBase_Raw", "RO")
    writer.number("FramePeriod", "Integer", "")
    writer.nodes.append(
        '<Converter Name="FrameRate_Falling"><pVariable Name="BASE">TimeBase_Raw</pVariable>'
        "<FormulaTo>BASE/FROM</FormulaTo><FormulaFrom>BASE/TO</FormulaFrom><pValue>FramePeriod</pValue>"
        "<Slope>Decreasing</Slope></Converter>"
    )
    writer.nodes.append(
        '<Float Name="AcquisitionFrameRateAbs"><pValue>FrameRate_Falling</pValue><Unit>Hz</Unit></Float>'
    )


def chunk_control(writer: Writer, declared: dict[str, tuple[str, str]]) -> None:
    """Switches for the chunks that `declared` names, and the chunks themselves."""
    writer.register("IntReg", "ChunkModeActive_Raw")
    writer.nodes.append('<Boolean Name="ChunkModeActive"><pValue>ChunkModeActive_Raw</pValue></Boolean>')
    chunks = {name: kind for name, kind in declared.items() if name.startswith("Chunk") and kind[0]}
    if not chunks:
        return
    entries = {name.removeprefix("Chunk"): number for number, name in enumerate(chunks)}
    writer.choice("ChunkSelector", entries, ("ChunkEnable",))
    writer.register("IntReg", "ChunkEnable_Raw")
    writer.nodes.append('<Boolean Name="ChunkEnable"><pValue>ChunkEnable_Raw</pValue></Boolean>')
    for number, (name, (type_, unit)) in enumerate(chunks.items()):
        writer.chunk(name, type_, unit, 0x9A000001 + number)


def document(model: str, name_space: str, nodes: list[str]) -> bytes:
    """The description with these nodes."""
    names = "".join(f"<pFeature>{name}</pFeature>" for name in _features_of(nodes))
    text = (
        '<?xml version="1.0" encoding="utf-8"?>'
        '<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1" '
        f'ModelName="{model}" VendorName="Nobody" StandardNameSpace="{name_space}" SchemaMajorVersion="1" '
        'SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ToolTip="" ProductGuid="1" VersionGuid="1">'
        f'<Category Name="Root">{names}</Category>{"".join(nodes)}<Port Name="Device"/></RegisterDescription>'
    )
    return text.encode()


def _features_of(nodes: list[str]) -> Iterator[str]:
    for node in nodes:
        name = node.split('"')[1]
        if "_" not in name:
            yield name
