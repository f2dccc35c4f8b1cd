from __future__ import annotations

from xml.etree import ElementTree

import pytest

from autoexpose_daemon.ros2.domain import Domain
from imaging.errors import ConfigurationError


@pytest.mark.parametrize(
    ("environment", "domain"),
    [
        ({}, Domain(0, "jazzy")),
        ({"ROS_DOMAIN_ID": "", "ROS_DISTRO": ""}, Domain(0, "jazzy")),
        ({"ROS_DOMAIN_ID": "42", "ROS_DISTRO": "humble"}, Domain(42, "humble")),
        ({"ROS_LOCALHOST_ONLY": "1"}, Domain(local=True)),
        ({"ROS_LOCALHOST_ONLY": "0"}, Domain()),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, Domain(local=True)),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", "ROS_STATIC_PEERS": "10.0.0.2"}, Domain()),
        ({"ROS_STATIC_PEERS": "10.0.0.2; localhost;"}, Domain(peers=("10.0.0.2", "127.0.0.1"))),
        ({"ROS_STATIC_PEERS": "10.0.0.2", "ROS_LOCALHOST_ONLY": "1"}, Domain(local=True)),
        (
            {"ROS_STATIC_PEERS": "10.0.0.2", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
            Domain(multicast=False, peers=("10.0.0.2",)),
        ),
        ({"ROS_DISTRO": "lyrical"}, Domain(release="lyrical")),
    ],
)
def test_the_variables_of_ros_2_are_followed(environment: dict[str, str], domain: Domain) -> None:
    assert Domain.from_environment(environment) == domain


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("ROS_DOMAIN_ID", "233", "set it to a number from 0 to 232"),
        ("ROS_DOMAIN_ID", "-1", "set it to a number from 0 to 232"),
        ("ROS_DOMAIN_ID", "\u0663", "set it to a number from 0 to 232"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "set it to one of SUBNET"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "which hides the topics from everyone"),
    ],
)
def test_others_are_refused_in_a_sentence(variable: str, value: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=f"^{variable} is .*{words}"):
        Domain.from_environment({variable: value})


DOMAINS = [Domain(), Domain(local=True), Domain(peers=("10.0.0.2",)), Domain(multicast=False, peers=("10.0.0.2",))]


@pytest.mark.parametrize("domain", DOMAINS)
def test_cyclone_gets_xml_and_what_the_user_configured_after_it(domain: Domain) -> None:
    ours, theirs = domain.cyclone_uri("file:///etc/cyclone.xml").rsplit(",", 1)
    root = ElementTree.fromstring(ours)
    assert theirs == "file:///etc/cyclone.xml"
    assert domain.cyclone_uri() == ours
    interfaces = [interface.get("name") for interface in root.iter("NetworkInterface")]
    assert interfaces == (["lo"] if domain.local else [])
    here = () if domain.multicast and not domain.local else ("127.0.0.1",)
    assert tuple(peer.get("Address") for peer in root.iter("Peer")) == (*here, *domain.peers)
    assert [index.text for index in root.iter("ParticipantIndex")] == ["auto"]  # or peers would not find it


def test_a_peer_that_is_not_known_is_left_out_and_named(caplog: pytest.LogCaptureFixture) -> None:
    domain = Domain.from_environment({"ROS_STATIC_PEERS": "nobody.invalid;10.0.0.2;" + "x" * 300})
    assert domain.peers == ("10.0.0.2",)
    assert "'nobody.invalid' is not known here" in caplog.text


def test_nodes_announced_themselves_in_another_form_before_iron() -> None:
    early = [release for release in ("foxy", "humble", "iron", "jazzy", "lyrical") if Domain(release=release).early]
    assert early == ["foxy", "humble"]
