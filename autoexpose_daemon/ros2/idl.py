"""Message types as Cyclone DDS wants them, made from the definitions that messages are written with."""

from __future__ import annotations

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as idl_types
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from autoexpose_daemon.messages.types import dds_name

types: Any = idl_types  # generic in ways that its annotations do not say
_BASIC: dict[str, Any] = {
    "bool": bool, "byte": types.uint8, "char": types.uint8, "string": str,
    "int8": types.int8, "int16": types.int16, "int32": types.int32, "int64": types.int64,
    "uint8": types.uint8, "uint16": types.uint16, "uint32": types.uint32, "uint64": types.uint64,
    "float32": types.float32, "float64": types.float64,
}  # fmt: skip


@cache
def dds_type(message_type: str, typestore: Typestore) -> type[IdlStruct]:
    """The type of a message, under its name in ROS 2's DDS; KeyError for an unknown one."""
    members = {name: _member(field, typestore) for name, field in typestore.fielddefs[message_type][1]}
    return make_idl_struct(message_type.rpartition("/")[2], dds_name(message_type), members)


def _member(field: Any, typestore: Typestore) -> Any:
    kind, of = field
    if kind is Nodetype.NAME:
        return dds_type(of, typestore)
    if kind is Nodetype.BASE:
        name, longest = of
        return types.bounded_str[longest] if name == "string" and longest else _BASIC[name]
    element, count = _member(of[0], typestore), of[1]
    if kind is Nodetype.ARRAY:
        return types.array[element, count]
    return types.sequence[element, count] if count else types.sequence[element]
