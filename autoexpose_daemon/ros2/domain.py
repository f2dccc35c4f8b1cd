"""The domain of ROS 2 and how far it reaches, from the variables that ROS 2 itself follows."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN
from imaging.errors import ConfigurationError

log = logging.getLogger(__name__)

DEFAULT_RELEASE = "jazzy"
EARLY = ("foxy", "galactic", "humble")
"""Releases whose nodes announce themselves in the form before Iron's."""

_RANGES = ("SUBNET", "LOCALHOST", "SYSTEM_DEFAULT")
_LOOPBACK = "127.0.0.1"
_MOST_PARTICIPANTS = 60
"""On one machine: discovery by unicast tries a port for each, and the last domain has no more ports."""
_LARGE_MESSAGES = "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>"
"""As Fast DDS sends them. By Cyclone's default an image is 290 packets, of which receivers lose some."""


@dataclass(frozen=True, slots=True)
class Domain:
    """Where topics are offered: ROS_DOMAIN_ID and the release, ROS_DISTRO.

    With `local` only programs on this machine take part, through loopback. Others are looked for by `multicast`, and at
    the IPv4 addresses `peers`.
    """

    number: int = 0
    release: str = DEFAULT_RELEASE
    local: bool = False
    multicast: bool = True
    peers: tuple[str, ...] = ()

    @property
    def early(self) -> bool:
        """Whether the release is one before Iron."""
        return self.release in EARLY

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Domain:
        """As a ROS 2 node would read it; names of peers that cannot be resolved here are left out, and logged.

        Raises ConfigurationError, naming the variable and what to set it to.
        """
        number = environment.get("ROS_DOMAIN_ID") or "0"
        if not (number.isascii() and number.isdigit() and int(number) <= LAST_ROS2_DOMAIN):
            raise ConfigurationError(f"ROS_DOMAIN_ID is {number!r}: set it to a number from 0 to {LAST_ROS2_DOMAIN}")
        release = environment.get("ROS_DISTRO") or DEFAULT_RELEASE
        reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or "SUBNET"
        if reach not in _RANGES:
            why = ", which hides the topics from everyone" if reach == "OFF" else ""
            raise ConfigurationError(
                f"ROS_AUTOMATIC_DISCOVERY_RANGE is {reach!r}{why}: set it to one of {', '.join(_RANGES)}"
            )
        if environment.get("ROS_LOCALHOST_ONLY") == "1":
            return cls(int(number), release, local=True)
        named = environment.get("ROS_STATIC_PEERS", "") if reach != "SYSTEM_DEFAULT" else ""
        peers = tuple(_addresses(named))
        here = reach == "LOCALHOST"
        return cls(int(number), release, here and not peers, not (here and peers), peers)

    def cyclone_uri(self, configured: str = "") -> str:
        """CYCLONEDDS_URI for this; what the user has `configured` there comes last, and so prevails."""
        general = _LARGE_MESSAGES
        if self.local:
            general += '<Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>'
        if self.local or not self.multicast:
            general += f"<AllowMulticast>{'spdp' if self.multicast else 'false'}</AllowMulticast>"
        nearby = (_LOOPBACK,) if self.local or not self.multicast else ()
        addresses = "".join(f'<Peer Address="{address}"/>' for address in (*nearby, *self.peers))
        discovery = (
            "<ParticipantIndex>auto</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{_MOST_PARTICIPANTS}</MaxAutoParticipantIndex>"
        ) + (f"<Peers>{addresses}</Peers>" if addresses else "")
        ours = f'<Domain Id="any"><General>{general}</General><Discovery>{discovery}</Discovery></Domain>'
        return ",".join(filter(None, (f"<CycloneDDS>{ours}</CycloneDDS>", configured)))


def _addresses(peers: str) -> Iterator[str]:
    """The addresses in ROS_STATIC_PEERS. Cyclone DDS would end the process over a name that it cannot resolve."""
    for peer in filter(None, (peer.strip() for peer in peers.split(";"))):
        try:
            yield str(socket.getaddrinfo(peer, None, socket.AF_INET)[0][4][0])
        except (OSError, UnicodeError):
            log.warning("ROS_STATIC_PEERS: %a is not known here, and is left out", peer)
