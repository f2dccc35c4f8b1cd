"""Inputs that once broke a parser, or would have: printed by the fuzzer, or written to a known pattern."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from autoexpose_daemon.messages.frames import MessageWriter
from fake_camera.usb3.usb.descriptors import CONTROL_IN, CONTROL_OUT
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet
from tests.autoexpose_daemon.publish.steps import DECISION
from tests.autoexpose_daemon.samples import EXPOSING, imu_message
from tests.fuzz.of_fake_camera import ATTACH, submit
from tests.fuzz.of_host import received
from tests.fuzz.of_robot import map_seeds
from tests.fuzz.target import framed

_BOMB = b"a: &a {x: 1, y: 2}\n" + b"".join(
    b"%c: &%c {<<: [*%c, *%c, *%c, *%c]}\n" % (new, new, *[new - 1] * 4) for new in b"bcdefghijklmnop"
)
"""Each mapping merges four of the one before: 4 to the 15th."""

_YAML = (
    b"!!int ''",
    b"!!float ''",
    b"!!bool maybe",
    b"!!timestamp then",
    b"2001-99-99",
    b"[" * 500,
    b"{a: " * 500,
    b'"\\ud800": 1',
    b"? [a]\n: 1",
    _BOMB,
)
_READ = struct.pack("<4sHHHHQHH", b"U3VC", 1 << 14, 0x800, 12, 1, 0, 0, 4)
_HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
_PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0H\0\0\x006\x08\0\0\0\0A\xae\x80*"


def _description(nodes: str) -> bytes:
    return framed(f"<RegisterDescription>{nodes}<Port Name='Device'/></RegisterDescription>".encode())


def _gain(formula: str, more: str = "") -> bytes:
    """A description whose gain is a formula."""
    return _description(
        f"<Float Name='Gain'><pValue>F</pValue></Float><SwissKnife Name='F'>{formula}</SwissKnife>{more}"
    )


def _doubling() -> str:
    node = "<SwissKnife Name='N{}'><pVariable Name='A'>N{}</pVariable><pVariable Name='B'>N{}</pVariable>"
    nodes = [node.format(here, here + 1, here + 1) + "<Formula>A+B</Formula></SwissKnife>" for here in range(40)]
    return "".join(nodes) + "<Integer Name='N40'><Value>1</Value></Integer>"


def _published(bits: int, exposure_time_us: float) -> bytes:
    """One frame as it is sent, with what no camera has."""
    sent_us = 1234.5
    frame = Frame(np.ones((2, 3), np.uint16), bits, 1, 1, 1, 0, ExposureSetting(sent_us, 0.0))
    sent = received(MessageWriter("rig", 1).messages(FrameSet(1, {"left": frame}), {"left": DECISION}, 0, 0))
    return sent.replace(struct.pack("<d", sent_us), struct.pack("<d", exposure_time_us))


def _report(pairs: bytes) -> bytes:
    return b'{"pairs": %s, "missed": 0, "lost": 0, "too_slow": 0, "alone": 0}' % pairs


def _decided(frame_id: int, sequence: int, decided_us: float, shape: tuple[int, int] = (2, 3)) -> bytes:
    """One frame with numbers that no daemon sends."""
    frame = Frame(np.ones(shape, np.uint8), 8, frame_id, 1, 1, 0, ExposureSetting(100.0, 0.0))
    decision = replace(DECISION, setting=ExposureSetting(decided_us, 0.0))
    return received(MessageWriter("rig", 1).messages(FrameSet(1, {"left": frame}), {"left": decision}, sequence, 0))


FOUND: dict[str, Iterable[bytes]] = {
    "usb3": (ATTACH + submit(1, CONTROL_IN, 64) * 2 + submit(2, CONTROL_OUT, len(_READ), _READ) * 2,),
    "fault-orders": (b"[" * 100_000, b'{"fault": {}}', b'{"fault": "freeze", "count": 1e999}'),
    "control-socket": (
        b"[" * 100_000,
        b"x" * 4096 + b"\n\n" + b"x" * 4097,
        b'{"fault": "freeze", "count": 1' + b"0" * 4000 + b"}",
    ),
    "light-script": (*_YAML, b"light: [{at_s: 0, lux: 1" + b"0" * 400 + b"}]"),
    "line0": (b"", b"no wire", b"AELINE0\x01"),
    "radiance": (_HDR + b"-Y 999999 +X 999999\n", _HDR + b"-Y 1 +X 8\n" + b"9999" * 6 + b"\1\1\1\1\xff\xff\xff\xff"),
    "genicam-xml": (
        framed(b"<?xml version='1.0' encoding='nope'?><RegisterDescription/>"),
        framed(b"<?xml version='1.0' encoding='shift_jis'?><RegisterDescription/>"),
        _description("<Group>" * 2000 + "</Group>" * 2000),
        _description("<Float Name='Gain'><pValue>A</pValue></Float><Float Name='A'><pValue>Gain</pValue></Float>"),
        _description("<IntReg Name='Gain'><Address>0</Address><Length>4294967296</Length></IntReg>"),
        _description("<IntReg Name='Gain'><Address>x</Address><Length>4</Length></IntReg>"),
        _description("<FloatReg Name='Gain'><Address>0</Address><Length>3</Length></FloatReg>"),
        _gain("<Expression Name='E'>E</Expression><Formula>E</Formula>"),
        _gain(f"<Formula>{'(' * 9000}</Formula>"),
        _gain("<Formula>((2**1023)**1023)**1023</Formula>"),
        _gain("<Formula>1&lt;&lt;99999999999</Formula>"),
        _gain("<Formula>(0-8)**0.5</Formula>"),
        _gain("<pVariable Name='A'>N0</pVariable><Formula>A</Formula>", _doubling()),
    ),
    "sysfs": (b"inf", b"nan", b"9" * 400),
    "response-file": (*_YAML, b"format: &a [" + b"1, " * 999 + b"]\nlog2_exposure: *a\nblack_level: *a\n"),
    "config": (
        *_YAML,
        b'cameras: {left: {serial: A, response: "\\0"}}',
        b'cameras: {left: {serial: A}}\ncontrol: {roi: {left: {mask: "\\0"}}}',
        b"cameras: {left: {serial: A}}\npublish: {zenoh: " + b"a" * 300 + b"}",
    ),
    "mask": (_PNG + b"\x8a\0\0nIDATH\r", _PNG[:16] + b"\0\0\xff\xff\0\0\xff\xff" + _PNG[24:] + b"\0\0\0\0IEND\0\0\0\0"),
    "exposure-list": (b"a" * 300 + b" 0.1", b"\0 0.1", b"a.png 1/0"),
    "image-file": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\xff\xff\0\0\xff\xff\x08\0\0\0\0\0\0\0\0",),
    "last-exposure": (b"[" * 100_000, b"{}", b"null"),
    "published": (
        _published(3, 100.0),
        _published(12, math.nan),
        _published(12, 0.5),
        *(_decided(1, 1, decided_us) for decided_us in (-5.0, 0.0, math.inf)),
        _decided(1, 1, 100.0, (0, 3)),
        _decided(1, 1, 100.0) + _decided(2**63, 2**63, 100.0),
    ),
    "map": [each.replace(b"CREATE TABLE meta", b"CREATE TABLE m\xffta") for each in map_seeds()],
    "imu": (imu_message((math.nan, 0.0, 0.0)), imu_message((0.0, 1e308, 1e308))),
    "truth": (b"{}", b"[" * 100_000, b'{"trigger": 1, "host_time_ns": 1e999, "lux": 1}', b'{"trigger": 1, "host'),
    "tally": (
        b"[" * 100_000,
        *(_report(pairs) for pairs in (b"1e999", b"-1", b"1" + b"0" * 400, b"true", b'"1"')),
    ),
    "status": (
        *(EXPOSING.to_json().replace("432000", number).encode() for number in ("-1", "1" + "0" * 400, "1e999")),
        *(EXPOSING.to_json().replace("1700000000.0", number).encode() for number in ("1e300", "NaN", "-1e12")),
        *(EXPOSING.to_json().replace("0.25", number).encode() for number in ("NaN", "Infinity", "1e308", "-1e308")),
        *(EXPOSING.to_json().replace("7200.0", number).encode() for number in ("NaN", "Infinity")),
    ),
    "calibration-file": (
        b"0.35 1e308 0.5 0.5 0.93\n1280 1024\n",
        b"Camera.type: PinHole\nCamera.width: 720\nCamera.height: 540\nCamera.fx: []\n",
        b"model_type: PINHOLE\nprojection_parameters: {fx: []}\nimage_width: 720\nimage_height: 540\n",
        b"K: [860, 0, 360, 0, 860, 270, 0, 0, 1]\nD: [0]\nmodel: omni\nsize: [720, 540]\n",
        b"K: [860, 0, 360, 0, 860, 270, 0, 0, 1]\nD: [0, 0, 0, 0]\nmodel: fov\nsize: [720, 540]\n",
    ),
    "page-request": (b"host: evil.com@127.0.0.1", b"host: [", b"cookie: \xff", b"authorization: Bearer \xff"),
    "control-setup": (b'{"dtype": "uint8", "shape": [99999999999999999999], "base64": ""}', b"[" * 100_000),
    "control-state": (b'{"dtype": [], "shape": [1.5], "base64": "AA=="}',),
}  # fmt: skip
"""By the name of their target."""
