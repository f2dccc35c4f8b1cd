"""Wireshark's dissectors, which know neither Aravis nor this project, understand every packet."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import time
from pathlib import Path

import pytest

from fake_camera.device.device import Device
from fake_camera.genicam.status import Status
from fake_camera.gige import gvcp
from fake_camera.gige.gvcp import Request
from fake_camera.ptp.messages import GROUP, Grandmaster, Message, MessageType, PortIdentity
from tests.fake_camera.gige.gige_client import (
    ACTION,
    CCP,
    DISCOVERY,
    GVCP_PORT,
    PACKETRESEND,
    READMEM,
    READREG,
    WRITEMEM,
    WRITEREG,
    GvcpClient,
    command,
    gige_camera,
)
from tests.fakes import loopback_address, unique

pytestmark = [
    pytest.mark.wire,
    pytest.mark.needs("tshark", "dumpcap"),
]

ADDRESS, CLIENT = loopback_address(), "127.0.0.1"
SERIAL = unique("SHARK")
CONTROL = 2
MASTER_CLOCK, SLAVE_CLOCK = "0x020000fffe000001", "0x020000fffe000002"
Datagram = tuple[tuple[str, int], tuple[str, int], bytes]


def write_pcap(path: Path, datagrams: list[Datagram]) -> None:
    """A capture file of raw IPv4 packets."""
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101))
        for number, (source, destination, data) in enumerate(datagrams):
            udp = struct.pack(">HHHH", source[1], destination[1], 8 + len(data), 0) + data
            addresses = socket.inet_aton(source[0]) + socket.inet_aton(destination[0])
            packet = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), number & 0xFFFF, 0, 64, 17, 0) + addresses + udp
            file.write(struct.pack("<IIII", 0, number, len(packet), len(packet)) + packet)


def tshark(path: Path, *arguments: str) -> list[str]:
    process = subprocess.run(
        ["tshark", "-r", str(path), *arguments], check=True, capture_output=True, text=True, timeout=60
    )
    return process.stdout.splitlines()


class Decoder:
    """A capture with all stream channels decoded as GVSP. Each start of tshark takes half a second."""

    def __init__(self, path: Path) -> None:
        self._path = path
        ports = set(tshark(path, "-Y", f"udp && !(udp.port=={GVCP_PORT})", "-T", "fields", "-e", "udp.dstport"))
        self._decode_as = [argument for port in sorted(ports) for argument in ("-d", f"udp.port=={port},gvsp")]

    def packets(self, display_filter: str) -> list[str]:
        """Summaries of those that a filter lets through."""
        return tshark(self._path, *self._decode_as, "-Y", display_filter)


def one_session(camera: Device) -> list[Datagram]:
    """All datagrams of a client that discovers, configures, streams, and asks for packets again."""
    datagrams: list[Datagram] = []
    with GvcpClient(ADDRESS, CLIENT) as client, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
        own = client.socket.getsockname()
        stream.bind((CLIENT, 0))
        stream.settimeout(2)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)

        def exchange(number: int, payload: bytes = b"") -> bytes:
            request = command(number, payload, request_id=len(datagrams) + 1)
            client.socket.sendto(request, (ADDRESS, GVCP_PORT))
            answer = client.socket.recv(2048)
            datagrams.extend([(own, (ADDRESS, GVCP_PORT), request), ((ADDRESS, GVCP_PORT), own, answer)])
            return answer

        def write(*pairs: int) -> None:
            exchange(WRITEREG, struct.pack(f">{len(pairs)}I", *pairs))

        def receive_block() -> None:
            while True:
                packet, source = stream.recvfrom(0x10000)
                datagrams.append((source, stream.getsockname(), packet))
                if packet[4] == 2:  # trailer
                    return

        exchange(DISCOVERY)
        exchange(READMEM, struct.pack(">IHH", 0x200, 0, 512))
        write(CCP, CONTROL)
        exchange(READREG, struct.pack(">III", 0x0004, 0x0934, CCP))
        write(0x0D18, 0x7F000001, 0x0D00, stream.getsockname()[1])
        exchange(WRITEMEM, struct.pack(">I", 0x00E8) + b"a name".ljust(16, b"\0"))
        # each way to be refused
        exchange(READREG, struct.pack(">I", 0x5000))
        exchange(WRITEREG, struct.pack(">II", 0x0000, 1))
        exchange(READMEM, struct.pack(">IHH", 0x5000, 0, 4))
        exchange(WRITEMEM, struct.pack(">I", 0x0D24) + bytes(4))
        write(0x0D04, 1 << 31 | 4000)
        packet, source = stream.recvfrom(0x10000)
        datagrams.append((source, stream.getsockname(), packet))
        camera.execute("AcquisitionStart")
        receive_block()
        camera.execute("AcquisitionStop")
        camera.features.set("ChunkModeActive", True)
        camera.features.set("ChunkEnable", True)
        camera.execute("AcquisitionStart")
        receive_block()
        camera.execute("AcquisitionStop")
        for first, last in ((0, 2), (5000, 5000)):
            request = command(PACKETRESEND, struct.pack(">HHII", 0, 1, first, last), request_id=900)
            datagrams.append((own, (ADDRESS, GVCP_PORT), request))
            client.socket.sendto(request, (ADDRESS, GVCP_PORT))
            answers = 0
            while answers <= last - first:  # among them may be packets of a frame that was under way at the stop
                packet, source = stream.recvfrom(0x10000)
                datagrams.append((source, stream.getsockname(), packet))
                answers += packet[:2] != b"\0\0"
        write(CCP, 0)
    return datagrams


@pytest.fixture(scope="module")
def session() -> list[Datagram]:
    with gige_camera(ADDRESS, SERIAL) as camera:
        return one_session(camera)


def test_every_packet_of_a_session_is_decoded_as_what_was_sent(session: list[Datagram], tmp_path: Path) -> None:
    write_pcap(tmp_path / "session.pcap", session)
    decoder = Decoder(tmp_path / "session.pcap")
    control = [datagram for datagram in session if GVCP_PORT in (datagram[0][1], datagram[1][1])]
    assert len(decoder.packets("gvcp")) == len(control)
    assert len(decoder.packets("gvsp")) == len(session) - len(control)
    assert decoder.packets("_ws.malformed") == []
    assert "LEADER [Block ID: 1 Packet ID: 0] IMAGE" in "\n".join(decoder.packets("gvsp.format == 1"))
    for seen in (
        "gvsp.sizex == 720 && gvsp.sizey == 540 && gvsp.pixel == 0x01080001",
        "gvsp.status == 0x0100",  # packets sent again
        "gvsp.status == 0x800c",  # one that is not to be had
        f'gvcp.bootstrap.serialnumber == "{SERIAL}"',
    ):
        assert decoder.packets(seen), seen


def test_a_packet_broken_on_purpose_is_reported(session: list[Datagram], tmp_path: Path) -> None:
    leader = next(
        index for index, (_, to, data) in enumerate(session) if to[1] != GVCP_PORT and data[4:8] == b"\1\0\0\0"
    )
    source, destination, data = session[leader]
    for cut in (20, 30):
        write_pcap(tmp_path / "broken.pcap", [*session[:leader], (source, destination, data[:cut])])
        assert len(Decoder(tmp_path / "broken.pcap").packets("_ws.malformed")) == 1


def test_ptp_messages_and_action_commands_are_decoded(tmp_path: Path) -> None:
    master, slave = PortIdentity(int(MASTER_CLOCK, 16)), PortIdentity(int(SLAVE_CLOCK, 16))
    messages = [
        Message(MessageType.ANNOUNCE, master, 1, log_interval=-1, grandmaster=Grandmaster(master.clock)),
        Message(MessageType.SYNC, master, 2, two_step=True, log_interval=-3),
        Message(MessageType.FOLLOW_UP, master, 2, 1_700_000_000_123_456_789),
        Message(MessageType.DELAY_REQ, slave, 3),
        Message(MessageType.DELAY_RESP, master, 3, 1_700_000_000_123_456_790, requester=slave),
    ]
    datagrams: list[Datagram] = [
        ((CLIENT, 319), (GROUP, 319 if message.type.is_event else 320), message.to_bytes()) for message in messages
    ]
    action = command(ACTION, struct.pack(">IIIQ", 0xCAFE, 7, 6, 1_700_000_000_123_456_789), 9, flags=0x81)
    answer = Request.from_bytes(action)
    assert answer is not None
    datagrams.append(((CLIENT, 40_000), (ADDRESS, GVCP_PORT), action))
    datagrams.append(((ADDRESS, GVCP_PORT), (CLIENT, 40_000), answer.acknowledge(b"", Status.ACTION_LATE)))
    write_pcap(tmp_path / "ptp.pcap", datagrams)
    fields = ["ptp.v2.messagetype", "ptp.v2.clockidentity", "ptp.v2.fu.preciseorigintimestamp.nanoseconds"]
    fields += ["ptp.v2.dr.requestingsourceportidentity", "ptp.v2.an.grandmasterclockidentity", "ptp.v2.flags.twostep"]
    fields += ["gvcp.cmd.action.devicekey", "gvcp.cmd.action.time", "gvcp.cmd.status", "_ws.malformed"]
    seen = tshark(tmp_path / "ptp.pcap", "-T", "fields", "-E", "separator=,", *(f"-e{field}" for field in fields))
    assert seen == [
        f"0x0b,{MASTER_CLOCK},,,{MASTER_CLOCK},0,,,,",
        f"0x00,{MASTER_CLOCK},,,,1,,,,",
        f"0x08,{MASTER_CLOCK},123456789,,,0,,,,",
        f"0x01,{SLAVE_CLOCK},,,,0,,,,",
        f"0x09,{MASTER_CLOCK},,{SLAVE_CLOCK},,0,,,,",
        ",,,,,,0x0000cafe,0x17979cfe3d85cd15,,",
        ",,,,,,,,0x8016,",
    ]


def test_events_are_decoded(tmp_path: Path) -> None:
    item = gvcp.event(0x9001, 7, 1_700_000_000_123_456_789, (7).to_bytes(8, "big"))
    told = gvcp.command(gvcp.Command.EVENTDATA, item, 3, ack_required=True)
    acknowledged = struct.pack(">HHHH", 0, gvcp.Command.EVENTDATA + 1, 0, 3)
    write_pcap(
        tmp_path / "event.pcap",
        [((ADDRESS, GVCP_PORT), (CLIENT, 40_000), told), ((CLIENT, 40_000), (ADDRESS, GVCP_PORT), acknowledged)],
    )
    fields = ["id", "devicespecificid", "blockid", "timestamp"]
    fields = [f"gvcp.cmd.event.{name}" for name in fields] + ["gvcp.cmd.eventdata.data", "_ws.malformed"]
    seen = tshark(tmp_path / "event.pcap", "-T", "fields", "-E", "separator=,", *(f"-e{field}" for field in fields))
    assert seen == [",0x9001,0x0007,0x17979cfe3d85cd15,0000000000000007,", ",,,,,"]


@pytest.mark.realtime
@pytest.mark.needs("arv-camera-test-0.8")
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may capture packets")
def test_a_capture_of_stock_aravis(tmp_path: Path) -> None:
    capture = tmp_path / "aravis.pcapng"
    with gige_camera(ADDRESS, SERIAL):
        dumpcap = subprocess.Popen(
            ["dumpcap", "-q", "-i", "lo", "-f", f"udp and (host {ADDRESS} or dst 255.255.255.255)", "-w", str(capture)],
            stderr=subprocess.PIPE,
            text=True,
        )
        assert dumpcap.stderr is not None
        try:
            if not any("File:" in line for line in iter(dumpcap.stderr.readline, "")):
                pytest.skip("capturing on lo is not permitted")
            wait_until_captured(capture)
            name = ["-n", f"Autoexpose-{SERIAL}"]
            subprocess.run(
                ["arv-camera-test-0.8", *name, "--duration", "1", "--no-packet-socket"],
                check=True,
                capture_output=True,
                timeout=30,
            )
        finally:
            dumpcap.terminate()
            dumpcap.communicate(timeout=10)
    decoder = Decoder(capture)
    assert len(decoder.packets("gvcp")) > 20
    assert len(decoder.packets("gvsp")) > 500
    assert decoder.packets("udp && !gvcp && !gvsp") == []
    assert decoder.packets("_ws.malformed") == []


def wait_until_captured(capture: Path) -> None:
    """dumpcap reports that it captures a moment before it does: send packets until one is in its file."""
    deadline_s = time.monotonic() + 5
    with GvcpClient(ADDRESS) as client:
        while time.monotonic() < deadline_s:
            client.ask(DISCOVERY)
            if capture.exists() and SERIAL.encode() in capture.read_bytes():
                return
            time.sleep(0.05)
    pytest.fail("dumpcap captured nothing")
