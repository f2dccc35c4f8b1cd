"""Which chunk data a camera sends, whether it wears a description or not."""

from __future__ import annotations

import math
from dataclasses import replace

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genicam.chunks import chunk_bytes, tagged
from fake_camera.genicam.registers import ByteOrder
from fake_camera.imaging import ExposedFrame


def sent_chunks(frame: ExposedFrame, device: Device, xml: XmlCamera | None, byte_order: ByteOrder) -> bytes:
    """The chunk data sent with a frame: those of the description that the camera wears, or its own; may be empty."""
    features = device.features
    if device.faults.spoils_frame(Fault.NO_CHUNKS):
        return b""
    if device.faults.spoils_frame(Fault.NAN_CHUNKS):
        frame = replace(frame, settings=replace(frame.settings, exposure_time_us=math.nan, gain_db=math.nan))
    if xml is not None:
        on = xml.chunks(frame)
        return b"" if on is None else tagged(frame, on, byte_order)
    return chunk_bytes(frame, features.enabled_chunks(), byte_order) if features.get("ChunkModeActive") else b""
