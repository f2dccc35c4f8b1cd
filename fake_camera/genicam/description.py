"""The GenICam description of the camera, written from the same table of features as its registers."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from fake_camera.device.feature_table import Spec
from fake_camera.device.features import NOT_IN_USER_SETS, Features
from fake_camera.genicam.chunks import CHUNKS
from fake_camera.genicam.events import EXPOSURE_END
from fake_camera.genicam.registers import (
    INCREMENT,
    LOCK,
    MAXIMUM,
    MINIMUM,
    ByteOrder,
    commands,
    has_limits,
    is_signed,
    slots,
    value_bytes,
)
from fake_camera.genicam.transport import RegisterField, Transport

_ELEMENT = {
    "integer": "Integer",
    "float": "Float",
    "boolean": "Boolean",
    "enumeration": "Enumeration",
    "string": "StringReg",
}

_CATEGORIES = {
    "DeviceControl": ("Device", "Timestamp"),
    "ImageFormatControl": ("Sensor", "Width", "Height", "Offset", "Binning", "Reverse", "PixelFormat"),
    "AcquisitionControl": ("Acquisition", "Exposure", "Trigger"),
    "DigitalIOControl": ("Line",),
    "AnalogControl": ("Gain", "Balance", "BlackLevel", "Gamma"),
    "ChunkDataControl": ("Chunk",),
    "EventControl": ("Event",),
    "UserSetControl": ("UserSet",),
    "ActionControl": ("Action",),
    "PtpControl": ("Ptp",),
    "TransportLayerControl": ("PayloadSize", "TLParamsLocked", "Gev", "U3V"),
}
"""The categories, with the prefixes of the features that belong to them."""

_SELECTED = {
    "GainSelector": ("Gain", "GainAuto"),
    "BalanceRatioSelector": ("BalanceRatio",),
    "LineSelector": ("LineMode", "LineSource", "LineInverter"),
    "TriggerSelector": ("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerOverlap", "TriggerSoftware"),
    "ChunkSelector": ("ChunkEnable",),
    "EventSelector": ("EventNotification",),
    "UserSetSelector": ("UserSetLoad", "UserSetSave"),
    "ActionSelector": ("ActionGroupKey", "ActionGroupMask"),
}


_EVENT_DATA = ("EventExposureEnd", "EventExposureEndTimestamp", "EventExposureEndFrameID")
"""The id, which comes first in every event, the time, and the data of ExposureEnd."""


def genicam_xml(features: Features, transport: Transport) -> bytes:
    """The description of all features of a camera on a transport (GenApi schema 1.1), UTF-8."""
    root = Element(
        "RegisterDescription",
        {
            "xmlns": "http://www.genicam.org/GenApi/Version_1_1",
            "ModelName": str(features.get("DeviceModelName")),
            "VendorName": str(features.get("DeviceVendorName")),
            "StandardNameSpace": transport.name_space,
            "SchemaMajorVersion": "1",
            "SchemaMinorVersion": "1",
            "SchemaSubMinorVersion": "0",
            "MajorVersion": "1",
            "MinorVersion": "0",
            "SubMinorVersion": "0",
            "ToolTip": "A simulated camera",
            "ProductGuid": "6f1c7b0e-6ad3-4f29-9c53-5b6d1f0a2e11",
            "VersionGuid": "0b0d7f58-6c3a-4f5f-8a43-93c2b1f2d7a4",
        },
    )
    _categories(root, features, transport)
    for name, address in slots(features).items():
        if name in commands(features):
            _command(root, name, address)
        else:
            _feature(root, features.spec(name), features.entries(name), address)
    for field in transport.fields:
        _bootstrap_field(root, field, transport.byte_order)
    _chunk_data(root)
    _event_data(root, transport.event_time_at)
    SubElement(root, "Port", Name="Device", NameSpace="Standard")
    for node in root.iter("Endianess"):
        node.text = {"big": "BigEndian", "little": "LittleEndian"}[transport.byte_order]
    indent(root)
    return bytes(tostring(root, "utf-8", xml_declaration=True))


def zipped(name: str, description: bytes) -> bytes:
    """The description in a zip archive; its length is a multiple of 4, the unit in which memory is read."""
    for padding in range(4):
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
            # ZipInfo has a fixed date, so that the same features give the same bytes
            file.writestr(zipfile.ZipInfo(f"{name}.xml"), description, zipfile.ZIP_DEFLATED)
            file.comment = b" " * padding
        if len(archive.getvalue()) % 4 == 0:
            break
    return archive.getvalue()


def _categories(root: Element, features: Features, transport: Transport) -> None:
    names = [*features.names, *commands(features)]
    names += [field.name for field in transport.fields] + [f"Chunk{name}" for name in CHUNKS] + [*_EVENT_DATA]
    top = SubElement(root, "Category", Name="Root", NameSpace="Standard")
    for category, beginnings in _CATEGORIES.items():
        members = [name for name in names if name.startswith(beginnings)]
        if not members:
            continue
        SubElement(top, "pFeature").text = category
        element = SubElement(root, "Category", Name=category, NameSpace="Standard")
        for name in members:
            SubElement(element, "pFeature").text = name


def _feature(root: Element, spec: Spec, entries: Mapping[str, int], address: int) -> None:
    node = SubElement(root, _ELEMENT[spec.type], Name=spec.name, NameSpace="Standard")
    access = "RW" if spec.writable else "RO"
    locked = spec.locked_while is not None
    if locked:
        SubElement(node, "pIsLocked").text = f"{spec.name}_Locked"
    if spec.type == "string":
        _register_body(node, address, value_bytes(spec), access)
        return
    SubElement(node, "ImposedAccessMode").text = access
    if spec.writable and spec.name not in NOT_IN_USER_SETS:
        SubElement(node, "Streamable").text = "Yes"
    for entry, value in entries.items():
        entry_node = SubElement(node, "EnumEntry", Name=entry, NameSpace="Standard")
        SubElement(entry_node, "Value").text = str(value)
    SubElement(node, "pValue").text = f"{spec.name}_Value"
    if spec.type == "boolean":
        SubElement(node, "OnValue").text = "1"
        SubElement(node, "OffValue").text = "0"
    _number(root, f"{spec.name}_Value", address, spec, access)
    if has_limits(spec):
        SubElement(node, "pMin").text = f"{spec.name}_Minimum"
        SubElement(node, "pMax").text = f"{spec.name}_Maximum"
        _number(root, f"{spec.name}_Minimum", address + MINIMUM, spec)
        _number(root, f"{spec.name}_Maximum", address + MAXIMUM, spec)
        if spec.increment:
            SubElement(node, "pInc").text = f"{spec.name}_Increment"
            _number(root, f"{spec.name}_Increment", address + INCREMENT, spec)
    if spec.unit:
        SubElement(node, "Unit").text = spec.unit
    for name in _SELECTED.get(spec.name, ()):
        SubElement(node, "pSelected").text = name
    if locked:
        _int_reg(root, f"{spec.name}_Locked", address + LOCK, 4, "RO")


def _number(root: Element, name: str, address: int, spec: Spec, access: str = "RO") -> None:
    if spec.type == "float":
        node = SubElement(root, "FloatReg", Name=name)
        _register_body(node, address, value_bytes(spec), access)
        SubElement(node, "Endianess")
    else:
        _int_reg(root, name, address, value_bytes(spec), access, sign="Signed" if is_signed(spec) else "Unsigned")


def _command(root: Element, name: str, address: int, value: int = 1) -> None:
    node = SubElement(root, "Command", Name=name, NameSpace="Standard")
    SubElement(node, "ImposedAccessMode").text = "WO"
    SubElement(node, "pValue").text = f"{name}_Value"
    SubElement(node, "CommandValue").text = str(value)
    _int_reg(root, f"{name}_Value", address, 4, "RW")


def _bootstrap_field(root: Element, field: RegisterField, byte_order: ByteOrder) -> None:
    element = {"integer": "Integer", "boolean": "Boolean", "command": "Command"}[field.type]
    node = SubElement(root, element, Name=field.name, NameSpace="Standard")
    access = "RW" if field.writable else "RO"
    if field.locked:
        SubElement(node, "pIsLocked").text = "TLParamsLocked"
    SubElement(node, "ImposedAccessMode").text = "WO" if field.type == "command" else access
    if field.streamable:
        SubElement(node, "Streamable").text = "Yes"
    SubElement(node, "pValue").text = f"{field.name}_Value"
    if field.type == "command":
        SubElement(node, "CommandValue").text = str(field.command_value)
    if field.limits is not None:
        for tag, limit in zip(("Min", "Max", "Inc"), field.limits, strict=True):
            SubElement(node, tag).text = str(limit)
    if field.unit:
        SubElement(node, "Unit").text = field.unit
    if field.length == 4:
        register = SubElement(root, "MaskedIntReg", Name=f"{field.name}_Value")
        _register_body(register, field.address, 4, access)
        for tag, bit in (("LSB", field.lsb), ("MSB", field.msb)):
            # GenICam counts from the highest bit in big-endian registers, from the lowest in little-endian ones.
            SubElement(register, tag).text = str(bit if byte_order == "big" else 31 - bit)
        SubElement(register, "Sign").text = "Unsigned"
        SubElement(register, "Endianess")
    else:
        _int_reg(root, f"{field.name}_Value", field.address, field.length, access)


def _chunk_data(root: Element) -> None:
    for name, chunk in CHUNKS.items():
        node = SubElement(root, chunk.type.capitalize(), Name=f"Chunk{name}", NameSpace="Standard")
        SubElement(node, "ImposedAccessMode").text = "RO"
        SubElement(node, "pValue").text = f"Chunk{name}_Value"
        if chunk.unit:
            SubElement(node, "Unit").text = chunk.unit
        register = SubElement(root, "FloatReg" if chunk.type == "float" else "IntReg", Name=f"Chunk{name}_Value")
        _register_body(register, 0, 8, "RO", port=f"Chunk{name}_Port")
        if chunk.type == "integer":
            SubElement(register, "Sign").text = "Unsigned"
        SubElement(register, "Endianess")
        port = SubElement(root, "Port", Name=f"Chunk{name}_Port")
        SubElement(port, "ChunkID").text = f"{chunk.chunk_id:X}"


def _event_data(root: Element, time_at: int) -> None:
    places = ((2, 2), (time_at, 8), (time_at + 8, 8))  # address and length
    for name, (address, length) in zip(_EVENT_DATA, places, strict=True):
        node = SubElement(root, "Integer", Name=name, NameSpace="Standard")
        SubElement(node, "ImposedAccessMode").text = "RO"
        SubElement(node, "pValue").text = f"{name}_Value"
        _int_reg(root, f"{name}_Value", address, length, "RO", port="EventExposureEnd_Port")
    SubElement(SubElement(root, "Port", Name="EventExposureEnd_Port"), "EventID").text = f"{EXPOSURE_END:X}"


def _int_reg(
    root: Element, name: str, address: int, length: int, access: str, *, sign: str = "Unsigned", port: str = "Device"
) -> None:
    node = SubElement(root, "IntReg", Name=name)
    _register_body(node, address, length, access, port)
    SubElement(node, "Sign").text = sign
    SubElement(node, "Endianess")


def _register_body(node: Element, address: int, length: int, access: str, port: str = "Device") -> None:
    SubElement(node, "Address").text = f"0x{address:X}"
    SubElement(node, "Length").text = str(length)
    SubElement(node, "AccessMode").text = access
    SubElement(node, "pPort").text = port
    SubElement(node, "Cachable").text = "NoCache"
