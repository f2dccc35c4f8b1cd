"""A node of ROS 2 on Cyclone DDS: its types, its topics, and the announcement by which `ros2 node list` knows it."""

from __future__ import annotations

import os
from functools import cache
from typing import Any

import numpy as np
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as idl_types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from autoexpose_daemon.messages.keys import DEFAULT, LATCHED, SENSOR_DATA, OfferedQos
from autoexpose_daemon.messages.types import TYPESTORE, dds_name
from autoexpose_daemon.ros2.domain import Domain

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


NAME = "autoexpose"

_PLAIN_CDR = Qos(Policy.DataRepresentation(use_cdrv0_representation=True))
_LITTLE_ENDIAN_CDR = b"\0\1"
_WRITERS = _PLAIN_CDR + Qos(Policy.DestinationOrder.BySourceTimestamp, Policy.WriterDataLifecycle(autodispose=False))
_RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=20))  # nobody is waited for longer than that


def _dds(qos: OfferedQos) -> Qos:
    return Qos(
        _RELIABLE if qos.reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
    )


_SENSOR_DATA, _DEFAULT, _LATCHED = map(_dds, (SENSOR_DATA, DEFAULT, LATCHED))

_GID, _NODE, _ENTITIES = (
    f"rmw_dds_common/msg/{name}" for name in ("Gid", "NodeEntitiesInfo", "ParticipantEntitiesInfo")
)


class Writer:
    """Publishes messages that are already serialised, on one topic, and counts them.

    Those that are not plain CDR are refused, and those that Cyclone DDS finds too short for their type.
    """

    def __init__(self, writer: DataWriter[IdlStruct], kind: type[IdlStruct]) -> None:
        self.sent = 0
        self.refused = 0
        self._writer = writer
        self._kind = kind

    def send(self, cdr: bytes) -> bool:
        """Publish a message as it is, or count it as refused; returns whether it was sent."""
        # The package serialises what it writes, field by field, which takes 14 ms for a small image: this one has been.
        sample: Any = self._kind.__new__(self._kind)
        sample.serialize = lambda **_: cdr
        sent = cdr.startswith(_LITTLE_ENDIAN_CDR)
        if sent:
            try:
                self._writer.write(sample)
            except DDSException:
                sent = False
        self.sent += sent
        self.refused += not sent
        return sent


class Node:
    """The node `/<rig>/autoexpose` of a domain; topics are named below the rig's namespace.

    Raises cyclonedds.core.DDSException when the domain cannot be joined.
    """

    def __init__(self, domain: Domain, rig: str) -> None:
        # Read by Cyclone DDS when the first participant of a process joins a domain.
        os.environ["CYCLONEDDS_URI"] = domain.cyclone_uri(os.environ.get("CYCLONEDDS_URI", ""))
        self._rig = rig
        self._marks_types = not domain.early
        self.participant = DomainParticipant(domain.number, Qos(Policy.Userdata(b"enclave=/;")))
        self._writers: list[DataWriter[IdlStruct]] = []
        self._readers: list[DataReader[IdlStruct]] = []
        self._store = get_typestore(Stores.ROS2_HUMBLE if domain.early else Stores.ROS2_JAZZY)
        announcement = self._writer("ros_discovery_info", _ENTITIES, _LATCHED, self._store)
        self._announcement = Writer(announcement, dds_type(_ENTITIES, self._store))

    def publisher(self, name: str, message_type: str, *, frames: bool = False, reliable: bool = False) -> Writer:
        """A topic to publish on. `frames`: like those of camera drivers, best effort unless `reliable`."""
        qos = (_SENSOR_DATA + Qos(_RELIABLE) if reliable else _SENSOR_DATA) if frames else _DEFAULT
        writer = self._writer(self._path(name), message_type, qos, TYPESTORE)
        self._writers.append(writer)
        return Writer(writer, dds_type(message_type, TYPESTORE))

    def subscription(self, name: str, message_type: str) -> DataReader[Any]:
        """A topic to take messages from."""
        kind = dds_type(message_type, TYPESTORE)
        qos = self._marked(_PLAIN_CDR + _DEFAULT, message_type, TYPESTORE)
        reader = DataReader(self.participant, Topic(self.participant, self._path(name), kind), qos=qos)
        self._readers.append(reader)
        return reader

    def announce(self) -> None:
        """Tell other participants which node these topics belong to; call it when all topics exist."""
        self._announcement.send(self._entities())

    def leave(self) -> None:
        """Say goodbye to others, which would otherwise keep node and topics for 10 s; nothing works afterwards."""
        self.participant.__del__()  # the package has no other way to delete it, and others refer to it

    def _path(self, name: str) -> str:
        return f"rt{name}" if name.startswith("/") else f"rt/{self._rig}/{name}"

    def _writer(self, path: str, message_type: str, qos: Qos, store: Typestore) -> DataWriter[IdlStruct]:
        topic = Topic(self.participant, path, dds_type(message_type, store))
        return DataWriter(self.participant, topic, qos=self._marked(_WRITERS + qos, message_type, store))

    def _marked(self, qos: Qos, message_type: str, store: Typestore) -> Qos:
        """With the hash of the type, where releases after Humble look for it."""
        if not self._marks_types:
            return qos
        return qos + Qos(Policy.Userdata(f"typehash={store.hash_rihs01(message_type)};".encode()))

    def _entities(self) -> bytes:
        """Which readers and writers belong to the node."""
        types = self._store.types
        gid_bytes = self._store.fielddefs[_GID][1][0][1][1][1]  # 24 in Humble, then 16

        def gid(entity: Any) -> Any:
            return types[_GID](np.frombuffer(entity.guid.bytes.ljust(gid_bytes, b"\0"), np.uint8))

        node = types[_NODE](
            f"/{self._rig}",
            NAME,
            *([gid(entity) for entity in entities] for entities in (self._readers, self._writers)),
        )
        return bytes(self._store.serialize_cdr(types[_ENTITIES](gid(self.participant), [node]), _ENTITIES))
