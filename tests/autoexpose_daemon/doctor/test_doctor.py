"""The doctor: what it makes of facts, how it says it, and the command against a camera on the wire."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from dataclasses import replace
from ipaddress import IPv4Interface
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import camera_setup
from autoexpose_daemon.doctor.examine import as_document, judge, judge_policy, show
from autoexpose_daemon.doctor.facts import Diagnosis, Facts, GigeFacts, Need, Severity
from autoexpose_daemon.doctor.judge import judge_gige
from drivers.host.network import (
    SOCKET_BUFFER_BYTES,
    Control,
    GigeCamera,
    NetworkInterface,
    bytes_per_s,
    needed_bytes_per_s,
)
from drivers.host.usb import DeviceNode, Process, UsbCamera, UsbFacts, find_usb
from drivers.setup import LinkShare
from tests import REPOSITORY
from tests.autoexpose_daemon.service.service_process import autoexpose
from tests.drivers.host.test_usb import UsbDevice, UsbTree
from tests.fake_camera.gige.gige_client import CCP, HEARTBEAT_TIMEOUT, GvcpClient
from tests.fakes import fake_camera, unique

NODE = DeviceNode("/dev/bus/usb/002/003", exists=True, usable=True, mode="crw-rw----", group="video", holders=())
USB = UsbCamera("U", "Maker", "Model", 5000, 2, 5000, "0000:00:14.0", NODE)
SOUND_USB = UsbFacts((USB,), usbfs_memory_mb=1000, udev_rule="/etc/udev/rules.d/60-usb3-vision.rules")
ETH = NetworkInterface("eth0", (IPv4Interface("192.168.7.1/24"),), 9000, 1000)
GIGE = GigeCamera("G", "Maker", "Model", IPv4Interface("192.168.7.5/24"), ETH)
SECOND = replace(GIGE, serial="H", address=IPv4Interface("192.168.7.6/24"))
TWO = {"left": {"serial": "G"}, "right": {"serial": "H"}}
ONE, BOTH = {"left": {"serial": "U"}}, {"left": {"serial": "U"}, "right": {"serial": "G"}}


def gige_facts(*cameras: GigeCamera, control: Control = "free", buffer: int | None = SOCKET_BUFFER_BYTES) -> GigeFacts:
    known = {camera.address: control for camera in cameras if camera.reachable}
    return GigeFacts(cameras, known, largest_socket_buffer_bytes=buffer)


def on(camera: GigeCamera, **changes: Any) -> GigeCamera:
    """The same camera on an interface that differs."""
    return replace(camera, interface=replace(camera.interface, **changes))


def usb_facts(**changes: Any) -> UsbFacts:
    """Facts on one camera that differs."""
    return replace(SOUND_USB, cameras=(replace(USB, **changes),))


def need(cameras: dict[str, Any] | None = None, **sections: Any) -> Need:
    return Need.of(None if cameras is None else Config.model_validate({"cameras": cameras, **sections}))


def troubles(facts: Facts, wanted: Need) -> dict[str, Severity]:
    return {finding.check: finding.severity for finding in judge(facts, wanted) if finding.severity != "ok"}


SOUND = Facts(SOUND_USB, gige_facts(GIGE))
NOTHING = Facts(UsbFacts(blind="no bus"), gige_facts())


@pytest.mark.parametrize("wanted", [need(), need(ONE), need(BOTH)])
def test_a_sound_host_has_no_troubles_and_each_camera_is_told(wanted: Need) -> None:
    findings = judge(SOUND, wanted)
    assert {finding.severity for finding in findings} == {"ok"}
    for serial in ("U", "G"):
        assert any(f"camera {serial} (Maker Model)" in finding.sentence for finding in findings)


Trouble = tuple[Need, str, Severity, str, str]
"""For which need, which check says how badly, with which sentence and command (regular expressions)."""
USB_TROUBLES: list[tuple[UsbFacts, Need, str, Severity, str, str]] = [
    (usb_facts(speed_mbps=480), need(), "usb-link", "warning", "480 Mbit/s, which is not SuperSpeed", "lsusb -t"),
    (
        usb_facts(node=replace(NODE, exists=False, usable=False)),
        need(), "usb-node", "stops", "/dev/bus/usb/002/003 does not exist", "ls -l",
    ),
    (
        usb_facts(node=replace(NODE, usable=False)),
        need(), "usb-node", "stops", r"\(crw-rw----, group video\) may not be opened", "usermod -aG video",
    ),
    (
        usb_facts(node=replace(NODE, usable=False, group="root")),  # the rule came after the camera
        need(), "usb-node", "stops", "may not be opened", "^sudo udevadm control --reload && sudo udevadm trigger",
    ),
    (
        usb_facts(node=replace(NODE, holders=(Process(815, "arv-viewer-0.8"), Process(4711, "spinview")))),
        need(ONE), "usb-holder", "stops",
        r"left camera U is in use by arv-viewer-0.8 \(process 815\), spinview \(process 4711\)", "^kill 815 4711$",
    ),
    (
        usb_facts(bus_speed_mbps=480),
        need(ONE, trigger={"rate_hz": 120}), "usb-bandwidth", "warning",
        r"left camera U is on bus 2 .* 0000:00:14.0 and needs 47 MB/s of about 38 MB/s \(assuming 720x540", "lsusb -t",
    ),
    (
        replace(SOUND_USB, cameras=(USB, replace(USB, serial="V", speed_mbps=5000)), usbfs_memory_mb=16),
        need(), "usbfs-memory", "warning", "allows 16 MB for all USB transfers, less than the 1000", "systemd-tmpfiles",
    ),
    (replace(SOUND_USB, usbfs_memory_mb=None), need(), "usbfs-memory", "warning", "cannot be read", "systemd-tmpfiles"),
    (replace(SOUND_USB, udev_rule=None), need(), "udev-rule", "warning", "no udev rule", "60-usb3-vision.rules"),
    (UsbFacts(blind="no libusb"), need(), "usb-bus", "warning", "libusb does not load", "apt install libusb-1.0-0"),
    (UsbFacts(blind="no list"), need(), "usb-bus", "warning", "cannot list", "ls -l /dev/bus/usb"),
    (UsbFacts(blind="no bus"), need(), "usb-bus", "warning", "shows no USB", "ls /sys/bus/usb/devices"),
]  # fmt: skip


FOREIGN = replace(GIGE, address=IPv4Interface("169.254.0.1/16"))
SENSELESS = replace(GIGE, address=IPv4Interface("10.9.8.7/0"))
GIGE_TROUBLES: list[tuple[GigeFacts, Need, str, Severity, str, str]] = [
    (
        gige_facts(GIGE, control="held"),
        need(), "gige-control", "stops", r"camera G \(Maker Model\) at 192.168.7.5 on eth0 is controlled", "ss -uanp",
    ),
    (gige_facts(GIGE, control="silent"), need(), "gige-control", "stops", "a firewall", "ping -c 3 192.168.7.5"),
    (
        gige_facts(FOREIGN),
        need(), "gige-subnet", "stops", "169.254.0.1, outside the subnet 192.168.7.0/24 of eth0",
        "ip address add 169.254.0.2/16 dev eth0",
    ),
    (gige_facts(SENSELESS), need(), "gige-subnet", "stops", "10.9.8.7", "ip address add 10.9.8.1/24 dev eth0"),
    (
        gige_facts(on(GIGE, mtu_bytes=1500)),
        need(), "gige-packets", "warning", "an MTU of 1500 bytes: a frame takes 266", "ip link set dev eth0 mtu 9000",
    ),
    (
        gige_facts(on(GIGE, mtu_bytes=1500)),
        need(BOTH, transport={"packet_size_bytes": 8000}), "gige-packets", "stops",
        r"transport.packet_size_bytes 8000 exceeds the MTU of eth0, 1500 bytes", "ip link set dev eth0 mtu 8000",
    ),
    (
        replace(gige_facts(on(GIGE, mtu_bytes=8500)), packet_bytes={GIGE.address: 9000}),
        need(), "gige-packets", "warning",
        r"camera G .* streams packets of 9000 bytes at present, more than the MTU of eth0, 8500 bytes: .* in fragments",
        r"ip link set dev eth0 mtu 9000 .* transport.packet_size_bytes: 8500",
    ),
    (
        gige_facts(on(GIGE, speed_mbps=100)),
        need(), "gige-bandwidth", "warning", r"camera G is on eth0 and needs 24 MB/s of about 11 MB/s", "ethtool eth0",
    ),
    (
        gige_facts(GIGE, SECOND),
        need(TWO, trigger={"rate_hz": 110},
             image={"pixel_format": "Mono12"}, transport={"plan": True}),
        "gige-bandwidth", "warning",
        r"left camera G and right camera H share eth0 and need 172 MB/s of about 112 MB/s .* 16 bits at 110 Hz",
        "ethtool eth0",
    ),
    (
        gige_facts(GIGE, SECOND),
        need(TWO), "gige-bursts", "warning",
        "left camera G and right camera H send to eth0 at the same instant", "transport.plan: true .* at most 56 MB/s",
    ),
    (
        gige_facts(GIGE, buffer=212992),
        need(), "socket-buffer", "warning", "net.core.rmem_max allows socket buffers of 212992 bytes, less than",
        "net.core.rmem_max=4194304",
    ),
    (gige_facts(GIGE, buffer=None), need(), "socket-buffer", "warning", "cannot be read", "net.core.rmem_max=4194304"),
    (
        replace(gige_facts(GIGE), no_filter="Function not implemented"),
        need(), "stream-filter", "warning", "streams on eth0 accept packets from anyone.*: Function not implemented",
        r'iifname "eth0" .* ip saddr != \{ 192.168.7.5 \} drop',
    ),
    (
        replace(gige_facts(GIGE), failures={"eth1": "Operation not permitted"}),
        need(), "gige-search", "warning", "eth1 could not be searched .*: Operation not permitted", "show dev eth1",
    ),
]  # fmt: skip


@pytest.mark.parametrize(
    ("facts", "trouble"),
    [(Facts(trouble[0], gige_facts(GIGE)), trouble[1:]) for trouble in USB_TROUBLES]
    + [(Facts(SOUND_USB, trouble[0]), trouble[1:]) for trouble in GIGE_TROUBLES],
)
def test_each_trouble_is_found_alone_with_what_fixes_it(facts: Facts, trouble: Trouble) -> None:
    wanted, check, severity, sentence, fix = trouble
    assert troubles(facts, wanted) == {check: severity}
    (found,) = (finding for finding in judge(facts, wanted) if finding.severity != "ok")
    assert re.search(sentence, found.sentence), found
    assert found.fix is not None
    assert re.search(fix, found.fix), found


def test_a_configured_camera_that_is_missing_stops_and_the_others_are_named() -> None:
    findings = judge(SOUND, need({"left": {"serial": "X"}, "right": {"serial": "G"}}))
    (missing,) = (finding for finding in findings if finding.severity != "ok")
    assert missing.severity == "stops"
    assert missing.sentence == "left camera X not found; cameras found: G, U"


def test_a_node_out_of_reach_without_a_rule_is_mended_by_the_rule() -> None:
    usb = replace(usb_facts(node=replace(NODE, usable=False, group="root")), udev_rule=None)
    findings = judge(Facts(usb, gige_facts()), need())
    assert troubles(Facts(usb, gige_facts()), need()) == {"usb-node": "stops", "udev-rule": "warning"}
    assert len({finding.fix for finding in findings if finding.severity != "ok"}) == 1


@pytest.mark.parametrize(
    ("facts", "wanted", "expected"),
    [
        (NOTHING, need(), {"camera-missing": "stops", "usb-bus": "warning"}),
        (NOTHING, need(ONE), {"camera-missing": "stops", "usb-bus": "warning"}),
        (Facts(UsbFacts(blind="no bus"), gige_facts(GIGE)), need({"left": {"serial": "G"}}), {}),
        (Facts(replace(SOUND_USB, usbfs_memory_mb=0), gige_facts()), need(), {}),  # no limit
    ],
)
def test_what_is_missing_counts_where_it_is_needed(facts: Facts, wanted: Need, expected: dict[str, Severity]) -> None:
    assert troubles(facts, wanted) == expected


def test_troubles_of_cameras_that_the_configuration_does_not_name_do_not_count() -> None:
    busy = usb_facts(speed_mbps=480, node=replace(NODE, usable=False, holders=(Process(1, "init"),)))
    facts = Facts(replace(busy, usbfs_memory_mb=16, udev_rule=None), gige_facts(GIGE))
    assert troubles(facts, need({"left": {"serial": "G"}})) == {}
    foreign = Facts(SOUND_USB, gige_facts(FOREIGN, on(GIGE, mtu_bytes=1500), control="held", buffer=1))
    assert troubles(foreign, need(ONE)) == {}


def test_two_cameras_on_one_bus_share_it_and_on_two_they_do_not() -> None:
    rate_hz = 800.0  # 311 MB/s a camera: one fits on SuperSpeed, two do not
    second = replace(USB, serial="V")
    for bus, expected in ((2, {"usb-bandwidth": "warning"}), (4, {})):
        facts = Facts(replace(SOUND_USB, cameras=(USB, replace(second, bus=bus))), gige_facts())
        assert troubles(facts, Need(rate_hz=rate_hz)) == expected


def test_three_cameras_and_more_are_named_in_a_list_and_need_more_memory() -> None:
    usb = [replace(USB, serial=serial, bus=bus) for bus, serial in enumerate("UVWX")]
    facts = Facts(replace(SOUND_USB, cameras=tuple(usb)), gige_facts())
    (found,) = (finding for finding in judge(facts, need()) if finding.severity != "ok")
    assert found.check == "usbfs-memory" and "less than the 2000 that 4 cameras" in found.sentence
    assert found.fix is not None and found.fix.startswith("sed s/1000/2000/ systemd/usbfs-memory.conf")
    of_one = Facts(replace(SOUND_USB, cameras=tuple(usb)), gige_facts())
    assert troubles(of_one, need(ONE)) == {}
    shared = tuple(replace(camera, bus=2) for camera in usb[:3])
    findings = judge(Facts(replace(SOUND_USB, cameras=shared, usbfs_memory_mb=2000), gige_facts()), need())
    (found,) = (finding for finding in findings if finding.check == "usb-bandwidth")
    assert found.sentence.startswith("camera U, camera V and camera W share bus 2")


@pytest.mark.parametrize(
    ("links", "sharing"),
    [
        pytest.param({}, 4, id="all on one, unless told"),
        pytest.param({"C": "second", "D": "second"}, 2, id="two links"),
    ],
)
def test_a_plan_charges_a_link_with_the_cameras_that_name_it(links: dict[str, str], sharing: int) -> None:
    """As the daemon does, which does not know where the others are."""
    other = replace(ETH, name="eth1", addresses=(IPv4Interface("192.168.8.1/24"),))
    cameras = {
        serial: GigeCamera(serial, "Maker", "Model", IPv4Interface(f"{link}.{number}/24"), interface)
        for number, (serial, link, interface) in enumerate(
            [("A", "192.168.7", ETH), ("B", "192.168.7", ETH), ("C", "192.168.8", other), ("D", "192.168.8", other)], 5
        )
    }
    rig = {f"c{serial.lower()}": {"serial": serial, "link": links.get(serial)} for serial in cameras}
    facts = Facts(UsbFacts(blind="no bus"), gige_facts(*cameras.values()))
    fits_hz = bytes_per_s(1000, sharing) / needed_bytes_per_s(2 * 720 * 540, 9000, 1.0)
    for rate_hz, refused in ((0.999 * fits_hz, 0), (1.001 * fits_hz, 4)):
        wanted = need(rig, trigger={"rate_hz": rate_hz}, image={"pixel_format": "Mono16"}, transport={"plan": True})
        found = [each for each in judge(facts, wanted) if each.severity != "ok"]
        # Where each of two cameras sends too much, it is said once of both.
        assert [each.check for each in found] == min(refused, sharing) * ["gige-bandwidth"]
        config = Config.model_validate({"cameras": rig, "transport": {"plan": True}})
        assert all(setup.link_share == LinkShare(sharing) for setup in (camera_setup(config, name) for name in rig))


def test_links_that_do_not_fit_the_cables_are_told() -> None:
    rig = {"left": {"serial": "G"}, "right": {"serial": "H", "link": "second"}}
    wanted = need(rig, transport={"plan": True})
    (found,) = [each for each in judge_gige(gige_facts(GIGE, SECOND), wanted) if each.check == "gige-bursts"]
    assert found.severity == "warning"
    assert "left camera G and right camera H" in found.sentence and "eth0" in found.sentence


def frames(*features: dict[str, Any], **sections: Any) -> tuple[int, str]:
    """Bytes of a frame of a camera with these features, and what the doctor says of it."""
    wanted = need({"left": {"serial": "U", "features": list(features)}}, **sections)
    return wanted.frame_bytes("U"), wanted.in_words(["U"])


def test_a_frame_is_as_large_as_the_configuration_makes_it() -> None:
    assert frames() == (720 * 540, "assuming 720x540 pixels of 8 bits at 60 Hz")
    assert frames(image={"binning": 2}) == (360 * 270, "assuming 360x270 pixels of 8 bits at 60 Hz")
    halved = frames({"BinningHorizontal": 2}, {"BinningVertical": 2}, {"DecimationVertical": 2})
    assert halved == (360 * 135, "assuming 360x135 pixels of 8 bits at 60 Hz")
    region = frames({"Width": 640}, {"Width": 2448}, {"Height": 2048}, image={"pixel_format": "Mono12Packed"})
    assert region == (2448 * 2048 * 3 // 2, "2448x2048 pixels of 12 bits at 60 Hz")
    assert frames({"Width": 1440}) == (1440 * 540, "assuming 1440x540 pixels of 8 bits at 60 Hz")
    assert frames({"Width": True}, {"Height": "full"}, {"RegionSelector[1].Width": 8})[0] == 720 * 540


def test_each_camera_needs_what_its_own_features_make_of_it() -> None:
    wanted = need(
        {"left": {"serial": "G", "features": [{"Width": 1440}, {"Height": 1080}]}, "right": {"serial": "H"}},
        transport={"plan": True, "link_mbps": 500},
    )
    (found,) = [each for each in judge(Facts(UsbFacts(blind="no bus"), gige_facts(GIGE, SECOND)), wanted)
                if each.check == "gige-bandwidth"]  # fmt: skip
    assert found.severity == "warning"
    assert "need 118 MB/s of about 56 MB/s (assuming 1440x1080 and 720x540 pixels" in found.sentence


def test_the_doctor_warns_where_the_plan_refuses() -> None:
    """Two cameras on a link of 1000 Mb/s: the same figures as `transport.plan` uses."""
    share = bytes_per_s(1000, 2)
    fits_hz = share / needed_bytes_per_s(2 * 720 * 540, 9000, 1.0)
    for rate_hz, expected in ((0.999 * fits_hz, "ok"), (1.001 * fits_hz, "warning")):
        wanted = need(TWO, trigger={"rate_hz": rate_hz}, image={"pixel_format": "Mono16"})
        found = judge(Facts(UsbFacts(blind="no bus"), gige_facts(GIGE, SECOND)), wanted)
        assert [each.severity for each in found if each.check == "gige-bandwidth"] == [expected]


def test_what_is_read_from_a_host_is_judged(tmp_path: Path) -> None:
    """From files to findings: two cameras on one USB 2 bus, one of them held, as the kernel of a new machine is set."""
    tree = UsbTree(tmp_path)
    node = tree.plug_in(UsbDevice(bus=1, serial="U", speed_mbps=480))
    tree.plug_in(UsbDevice(bus=1, address=4, serial="V", speed_mbps=480))
    tree.hold(node, 815, "arv-viewer-0.8")
    tree.write(tmp_path / "sys/module/usbcore/parameters/usbfs_memory_mb", "16")
    facts = Facts(find_usb(tmp_path, tree.backend), gige_facts())
    assert troubles(facts, need({"left": {"serial": "U"}, "right": {"serial": "V"}})) == {
        "usb-link": "warning",
        "usb-holder": "stops",
        "usb-bandwidth": "warning",
        "usbfs-memory": "warning",
        "udev-rule": "warning",
    }


def test_commands_name_files_that_are_shipped() -> None:
    findings = judge(Facts(replace(SOUND_USB, usbfs_memory_mb=16, udev_rule=None), gige_facts()), need())
    files = re.findall(r"systemd/\S+", " ".join(finding.fix or "" for finding in findings))
    assert sorted(files) == ["systemd/60-usb3-vision.rules", "systemd/usbfs-memory.conf"]
    assert all((REPOSITORY / file).is_file() for file in files)


def test_a_missing_camera_is_looked_for_with_another_command_than_this() -> None:
    for wanted in (need(), need(ONE)):
        (missing,) = (finding for finding in judge(NOTHING, wanted) if finding.check == "camera-missing")
        assert missing.fix is not None
        assert missing.fix.startswith("autoexpose list ")


FINDINGS = [
    Diagnosis("a", "ok", "All is well."),
    Diagnosis("b", "stops", " ".join(["word"] * 40), "command " + "x" * 100),
]


def test_the_report_reads_without_colours_commands_stay_whole_and_json_holds_the_same() -> None:
    page = io.StringIO()
    show(FINDINGS, Console(file=page, width=60))
    lines = page.getvalue().splitlines()
    assert lines[0] == "ok       All is well."
    assert [line.split(maxsplit=1)[0] for line in lines[1:3]] == ["stops", "word"]
    assert "         $ command " + "x" * 100 in lines
    assert "(1 stops, 0 warning, 1 ok)" in lines[-1]
    assert max(len(line) for line in lines if "$" not in line) <= 60
    document = as_document(FINDINGS)
    assert document["stops"] is True
    assert [Diagnosis(**finding) for finding in document["findings"]] == FINDINGS
    assert as_document(FINDINGS[:1])["stops"] is False


WITHOUT_EXTENSION = """
import sys
sys.modules["autoexpose_daemon.control._native"] = None
from autoexpose_daemon.{} import {}
"""


def test_without_the_c_extension_it_says_so_and_goes_on() -> None:
    assert list(judge_policy(Config.model_validate({"cameras": ONE}))) == []
    program = WITHOUT_EXTENSION.format("doctor.examine", "judge_policy") + (
        "from autoexpose_daemon.config.document import Config\n"
        "for finding in judge_policy(Config.model_validate({'cameras': {'left': {'serial': 'A'}}})):\n"
        "    print(finding.check, finding.severity, finding.sentence)"
    )
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert said.startswith("policy stops ") and "C extension" in said and "gcc" in said


def test_without_the_c_extension_commands_that_decide_are_one_sentence(tmp_path: Path) -> None:
    program = WITHOUT_EXTENSION.format("cli", "main") + f"sys.argv[1:] = ['replay', '{tmp_path / 'x.mcap'}']\nmain()"
    result = subprocess.run([sys.executable, "-c", program], check=False, capture_output=True, text=True)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1 and "C extension" in result.stderr and "gcc" in result.stderr


@pytest.mark.wire
def test_the_command_on_a_camera_on_the_wire(tmp_path: Path) -> None:
    named, wrong = tmp_path / "rig.yaml", tmp_path / "wrong.yaml"
    missing = unique("MISSING")
    with fake_camera() as camera:
        named.write_text(f"cameras: {{left: {{serial: {camera.serial}}}}}")
        wrong.write_text(f"cameras: {{left: {{serial: {camera.serial}}}, right: {{serial: {missing}}}}}")

        result = autoexpose("doctor", "-c", str(named))
        assert result.returncode == 0, result.stdout
        assert f"left camera {camera.serial} (Autoexpose" in result.stdout
        assert result.stdout.splitlines()[-1].startswith("Nothing stops the daemon (0 stops, ")

        # Other cameras on this machine may be held, so the verdict without a configuration is theirs, too.
        result = autoexpose("doctor", "--json")
        document = json.loads(result.stdout)
        assert result.returncode == int(document["stops"])
        assert any(
            finding["severity"] == "ok" and finding["sentence"].startswith(f"camera {camera.serial} ")
            for finding in document["findings"]
        )

        result = autoexpose("doctor", "--json", "-c", str(wrong))
        assert result.returncode == 1
        assert result.stderr == ""
        (stop,) = (finding for finding in json.loads(result.stdout)["findings"] if finding["severity"] == "stops")
        assert stop["sentence"].startswith(f"right camera {missing} not found; cameras found: ")
        assert camera.serial in stop["sentence"]

        with GvcpClient(camera.address) as client:
            client.write(CCP, 2)
            client.write(HEARTBEAT_TIMEOUT, 60_000)  # asking the doctor may take longer than 3 s
            result = autoexpose("doctor", "--json", "-c", str(named))
        assert result.returncode == 1
        (stop,) = (finding for finding in json.loads(result.stdout)["findings"] if finding["severity"] == "stops")
        assert f"left camera {camera.serial} " in stop["sentence"]
        assert "is controlled by another program" in stop["sentence"]


@pytest.mark.parametrize(
    ("status", "level", "words"),
    [
        ("Slave", "ok", "follows a PTP clock (PtpStatus Slave)"),
        ("Disabled", "ok", "the daemon switches it on"),
        ("Listening", "warning", "follows no PTP master (PtpStatus Listening)"),
        (None, "warning", "does not show the state of a PTP clock"),
    ],
)
def test_ptp_is_judged_by_what_the_camera_shows(status: str | None, level: str, words: str) -> None:
    facts = replace(gige_facts(GIGE), ptp={GIGE.address: status})
    (finding,) = (finding for finding in judge_gige(facts, Need(ptp=True)) if finding.check == "ptp")
    assert finding.severity == level
    assert words in finding.sentence
    assert not any(finding.check == "ptp" for finding in judge_gige(facts, Need()))
    over_usb = judge(Facts(SOUND_USB, gige_facts()), Need(ptp=True))
    assert [finding.severity for finding in over_usb if finding.check == "ptp"] == ["stops"]
