"""Types made from definitions: what one implementation writes the other reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cyclonedds.idl import IdlStruct

from autoexpose_daemon.messages.types import (
    BOOL,
    CAMERA_INFO,
    DIAGNOSTICS,
    EXPOSURE_INFO,
    FLOAT64,
    IMAGE,
    ODOMETRY,
    STRING,
    TRACKED_CELLS,
    TYPESTORE,
)
from autoexpose_daemon.ros2.node import dds_type


def filled(kind: Any) -> Any:
    """A message with other content in each field, of rosbags' classes."""
    name, of = kind
    if name.name == "NAME":
        return TYPESTORE.types[of](*(filled(field) for _, field in TYPESTORE.fielddefs[of][1]))
    if name.name == "BASE":
        return "words" if of[0] == "string" else of[0] == "bool" or 7
    (inner, what), count = of
    if inner.name == "BASE" and what[0] != "string":
        return np.arange(count or 5).astype({"char": "uint8", "byte": "uint8"}.get(what[0], what[0]))
    return [filled((inner, what)) for _ in range(count or 2)]


def plain(value: Any) -> Any:
    """A message of either kind as lists and numbers."""
    if isinstance(value, IdlStruct):
        return [plain(getattr(value, name)) for name in type(value).__annotations__]
    if hasattr(value, "__msgtype__"):
        return [plain(getattr(value, name)) for name, _ in TYPESTORE.fielddefs[value.__msgtype__][1]]
    if isinstance(value, np.ndarray | list | tuple | bytes):
        return [plain(each) for each in value]
    return value


@pytest.mark.parametrize(
    "name", [IMAGE, CAMERA_INFO, EXPOSURE_INFO, DIAGNOSTICS, ODOMETRY, TRACKED_CELLS, BOOL, FLOAT64, STRING]
)
def test_messages_have_the_same_bytes_for_cyclone(name: str) -> None:
    message = filled((type("", (), {"name": "NAME"}), name))
    cdr = bytes(TYPESTORE.serialize_cdr(message, name))
    read = dds_type(name, TYPESTORE).deserialize(cdr)
    assert plain(read) == plain(message)
    written = read.serialize(use_version_2=False)
    assert written.rstrip(b"\0") == cdr.rstrip(b"\0")


def test_a_type_is_made_once() -> None:
    assert dds_type(IMAGE, TYPESTORE) is dds_type(IMAGE, TYPESTORE)
    assert dds_type(IMAGE, TYPESTORE).__idl__.idl_transformed_typename == "sensor_msgs::msg::dds_::Image_"
