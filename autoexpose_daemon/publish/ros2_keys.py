"""How rmw_zenoh, which carries ROS 2 over zenoh, names and marks what is published: keys, tokens, attachments.

It differs between releases. This follows rmw_zenoh_cpp 0.2, the line of ROS 2 Jazzy, from 0.2.4 on, where its change
log has the present form of attachments. Sources in github.com/ros2/rmw_zenoh: docs/design.md (commit 99a6a2b),
liveliness_utils.cpp (3411fde) and attachment_helpers.cpp (534747d). Not verified against a live ROS 2.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass

from autoexpose_daemon.messages.keys import SENSOR_DATA, OfferedQos
from autoexpose_daemon.messages.types import TYPESTORE, dds_name

_NODE_ID = 0
_NO_ENCLAVE = "%"
_BEST_EFFORT, _TRANSIENT_LOCAL = 2, 1  # of rmw's enumerations
_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16


@dataclass(frozen=True, slots=True)
class Ros2Topic:
    """One topic of a node: the key of its messages, and the liveliness token of its publisher."""

    key: str
    token: str


@dataclass(frozen=True, slots=True)
class Ros2Node:
    """A node of ours in ROS 2, `/<namespace>/<name>`, or `/<name>` if the namespace is empty.

    `domain` is ROS_DOMAIN_ID, `session` the id of the zenoh session, in hexadecimal digits.
    """

    domain: int
    namespace: str
    name: str
    session: str

    @property
    def token(self) -> str:
        """The liveliness token of the node."""
        return self._token("NN", _NODE_ID)

    def topic(self, number: int, name: str, message_type: str, qos: OfferedQos = SENSOR_DATA) -> Ros2Topic:
        """The topic of this full name; `number` numbers the publishers of a node, from 1."""
        path = name.strip("/")
        kind = f"{dds_name(message_type)}/{TYPESTORE.hash_rihs01(message_type)}"
        token = f"{self._token('MP', number)}/{_mangled(f'/{path}')}/{kind}/{_keyed(qos)}"
        return Ros2Topic(f"{self.domain}/{path}/{kind}", token)

    def _token(self, entity: str, number: int) -> str:
        ids = f"{self.session}/{_NODE_ID}/{number}/{entity}"
        return f"@ros2_lv/{self.domain}/{ids}/{_NO_ENCLAVE}/{_mangled(f'/{self.namespace}')}/{self.name}"


def key_of_topic(domain: int, topic: str, message_type: str = "") -> str:
    """The key of a topic's messages, whatever the hash of their type; without a type, those of any type."""
    return f"{domain}/{topic.strip('/')}/{dds_name(message_type) if message_type else '*'}/*"


class Attachments:
    """What goes with each message of one publisher: its number from 1 on, when it was sent, and the publisher's gid.

    The gid is our own: ROS 2 only needs it to differ between publishers. rmw_zenoh makes it from the token with
    another hash, so `ros2 topic info --verbose` shows a different one.
    """

    def __init__(self, topic: Ros2Topic) -> None:
        self._gid = hashlib.blake2b(topic.token.encode(), digest_size=_GID_BYTES).digest()
        self._sequence = 0

    def next(self, time_ns: int) -> bytes:
        """The attachment of the next message, sent at this CLOCK_REALTIME: little-endian, the gid after its length."""
        self._sequence += 1
        return _ATTACHMENT.pack(self._sequence, time_ns, _GID_BYTES, self._gid)


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def _keyed(qos: OfferedQos) -> str:
    """Reliability : durability : history, depth : deadline s, ns : lifespan s, ns : liveliness, lease s, ns.

    A field is empty where it is rmw_zenoh's default: reliable, volatile, keep last, no deadline or lease.
    """
    reliability, durability = "" if qos.reliable else _BEST_EFFORT, _TRANSIENT_LOCAL if qos.latched else ""
    return f"{reliability}:{durability}:,{qos.depth}:,:,:,,"
