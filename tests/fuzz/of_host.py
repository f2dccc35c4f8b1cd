"""What the host's side reads from outside: drivers, calibration and the daemon."""

from __future__ import annotations

import io
import json
import struct
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from ipaddress import IPv4Interface

import cv2
import numpy as np
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from PIL import Image
from prometheus_client.parser import text_string_to_metric_families
from pydantic_core import to_json as to_bytes
from rich.table import Table
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse

from autoexpose_daemon.client.control_client import rows_of
from autoexpose_daemon.client.received import ReceivedSet, SetAssembler, SetQueue
from autoexpose_daemon.client.top import Sparklines, panel_of
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.config.request import read_request
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import parse, plain
from autoexpose_daemon.demo.fakes import read_pulses
from autoexpose_daemon.messages.client import ConsumerTally, response_from_json, response_to_json, vignetting_from_json
from autoexpose_daemon.messages.frames import Message
from autoexpose_daemon.page.access import Access, Key
from autoexpose_daemon.page.metrics import exposition
from autoexpose_daemon.page.pair_views import ExposureHistory, PictureMaker
from autoexpose_daemon.recording.file import from_json, to_json
from autoexpose_daemon.recording.read import Recording
from autoexpose_daemon.recording.replay import Replay
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.service.last_exposure import FORMAT, LastExposure
from autoexpose_daemon.status.counters import Answer, AnsweredShot
from autoexpose_daemon.status.document import Status, grounds_from_json, grounds_to_json
from autoexpose_daemon.status.panel import line_of
from autoexpose_daemon.status.telemetry import Consumers
from calibration.document import CameraIdentity, Finding
from calibration.gain import GainFile
from calibration.geometry.file import load_geometry
from calibration.geometry.opencv import ros_yaml
from calibration.images import read_images, timed_files
from calibration.response.file import Origin, ResponseFile
from calibration.vignetting.file import VignettingFile
from drivers.genicam.image_format import decode_pixels
from drivers.host import network
from drivers.host.network import NetworkInterface, largest_socket_buffer_bytes
from fake_camera.device.line0 import Line0
from fake_camera.device.truth import TruthFile
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.gain_scale import GainScale
from imaging.pixels import PixelFormat
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting
from tests.autoexpose_daemon.publish.test_pairs import messages
from tests.autoexpose_daemon.recording.runs import LIMITS, VirtualRun, record
from tests.autoexpose_daemon.samples import EXPOSING, GROUNDS, imu_message
from tests.calibration.geometry.written import LENSES, WRITERS, camchain, made_rig, of_ros, ros
from tests.fuzz.of_fake_camera import gvcp_answer
from tests.fuzz.target import framed, in_file, unframed

LO = NetworkInterface("lo", (IPv4Interface("127.0.0.1/8"),), 65536, None)


def discovery(data: bytes) -> None:
    """What a camera answers to a search, and to the question who controls it."""
    camera = network._read_identity(data, LO)
    if camera is not None:
        str(camera.reachable)
    network._parse(data, 1)
    network.refusal(data)


def discovery_seeds() -> Iterator[bytes]:
    yield gvcp_answer()


def image_bytes(data: bytes) -> None:
    """A received buffer: pixel format, width and height before it."""
    if len(data) >= 12:
        code, width, height = struct.unpack(">III", data[:12])
        expected = next((each for each in PixelFormat if each.pfnc_code == code), PixelFormat.MONO8)
        decode_pixels(data[12:], code, width, height, expected, has_chunks=True)


def image_bytes_seeds() -> Iterator[bytes]:
    for pixel_format in PixelFormat:
        yield struct.pack(">III", pixel_format.pfnc_code, 4, 3) + bytes(36)


def sysfs(data: bytes) -> None:
    largest_socket_buffer_bytes(in_file(data, "root/proc/sys/net/core/rmem_max").parents[4])


def sysfs_seeds() -> Iterator[bytes]:
    yield from (b"65536\n", b"-1\n", b"1e3")


def response_file(data: bytes) -> None:
    path = in_file(data, "response.yaml")
    file = ResponseFile.load(path)
    file.check_belongs(file.origin.camera.serial if file.origin.camera else "X", file.origin.pixel_format)
    file.save(path.with_name("again.yaml"))


@cache
def _response_file() -> bytes:
    origin = Origin(CameraIdentity("Acme", "M1", "0042"), PixelFormat.MONO8, 1, 0.0, None, "autoexpose 0.1")
    found = (Finding("warned", "light_drift", "The light fell by 0.1 stops."),)
    path = in_file(b"", "made.yaml")
    uncertainty = tuple(np.linspace(0.1, 0.2, 256).tolist())
    ResponseFile(
        ResponseFunction.linear(4), origin, "gamma", {"gamma": 2.2}, (4, 250), 0.4, found, {"grey": [1.0, 2.0]},
        {"frames": 2}, uncertainty,
    ).save(path)  # fmt: skip
    return path.read_bytes()


def response_seeds() -> Iterator[bytes]:
    yield _response_file()
    curve = [round(float(stops), 1) for stops in ResponseFunction.linear().log2_exposure]
    document = {"format": "autoexpose-response/1", "black_level": 0, "saturation": 255, "log2_exposure": curve}
    yield yaml.safe_dump(document, default_flow_style=None, width=9999).encode()


def gain_file(data: bytes) -> None:
    path = in_file(data, "gain.yaml")
    file = GainFile.load(path)
    file.check_belongs(file.camera.serial if file.camera else "X")
    file.save(path.with_name("again.yaml"))


def gain_seeds() -> Iterator[bytes]:
    path = in_file(b"", "made-gain.yaml")
    found = (Finding("warned", "light_changed", "One gain differs by 0.2 dB."),)
    scale = GainScale("GainRaw", (0.0, 10.0, 20.0), (0.0, 1.5, 6.0))
    identity = CameraIdentity("Acme", "M1", "0042")
    GainFile(scale, 0.05, camera=identity, tool="autoexpose 0.1", findings=found).save(path)
    yield path.read_bytes()
    yield b"format: autoexpose-gain/1\nnode: Gain\nsettings: [1.0, 16.0]\ngains_db: [0.0, 24.0]\n"


def vignetting_file(data: bytes) -> None:
    path = in_file(data, "vignetting.yaml")
    file = VignettingFile.load(path)
    file.check_belongs(file.camera.serial if file.camera else "X", (file.vignetting.width, file.vignetting.height))
    assert file.vignetting.relative_light(48, 64).max() == 1.0
    file.save(path.with_name("again.yaml"))


def vignetting_seeds() -> Iterator[bytes]:
    path = in_file(b"", "made-vignetting.yaml")
    found = (Finding("warned", "uneven_light", "Opposite parts differ by 12 %."),)
    lens = Vignetting(720, 540, (350.0, 270.0), (-0.6, 0.2))
    identity = CameraIdentity("Acme", "M1", "0042")
    VignettingFile(lens, 0.01, camera=identity, tool="autoexpose 0.1", findings=found).save(path)
    yield path.read_bytes()
    yield b"format: autoexpose-vignetting/1\nwidth: 90\nheight: 68\ngrid: [[0.5, 1.0, 0.5], [0.6, 1.0, 0.4]]\n"


def calibration_file(data: bytes) -> None:
    path = in_file(data, "calibration.yaml")
    geometry = load_geometry(path, "right")
    assert of_ros(yaml.safe_load(ros_yaml(geometry, "right"))) == geometry


def calibration_seeds() -> Iterator[bytes]:
    for document in (ros("right"), *map(camchain, LENSES)):
        yield yaml.safe_dump(document, default_flow_style=None, width=9999).encode()
    folder = in_file(b"", "calibration.yaml").parent
    for name, write in WRITERS.items():
        file = write(made_rig(), folder)
        yield (file if name != "vins" else folder / "cam0_pinhole.yaml").read_bytes()
    yield b"0.35 0.4375 0.5 0.5 0.93\n1280 1024\ncrop\n640 480\n"
    lens = b"camera matrix\n860 0 360\n0 860 270\n0 0 1\ndistortion\n0 0 0 0\n"
    yield b"[image]\nwidth\n720\nheight\n540\n[a/right]\n" + lens


def config(data: bytes) -> None:
    """A configuration, with a response file and a mask beside it."""
    in_file(_response_file(), "made.yaml")
    in_file(_mask(), "mask.png")
    path = in_file(data, "rig.yaml")
    load_config(path)


def config_seeds() -> Iterator[bytes]:
    yield b'cameras: {left: {serial: "0042", response: made.yaml}, right: {serial: "2"}}\n'
    yield (
        b'cameras:\n  left: {serial: "1"}\n  right: {serial: "2"}\n'
        b"trigger: {mode: external, line: Line0, rate_hz: 60}\n"
        b"exposure: {min_time_us: 20, max_time_us: 7500, min_gain_db: 0, max_gain_db: 30}\n"
        b"motion: {imu: {key: 0/imu/data/*, max_age_s: 0.1}}\n"
        b"control:\n  policy: begin2022\n  focal_length_px: 800\n"
        b"  start: {exposure_time_us: 2000, gain_db: 3}\n  balance: flicker\n"
        b"  roi:\n    left: &roi\n      mask: mask.png\n      background_weight: 0.2\n"
        b"      rectangles: [{box: [0, 0, 20, 20], weight: 0.5}]\n    right: *roi\n"
        b"transport: {packet_size_bytes: 1500}\nimage: {pixel_format: Mono8, binning: 2}\n"
        b"publish: {rig: rig, listen: [tcp/127.0.0.1:7447], connect: []}\n"
    )


def mask(data: bytes) -> None:
    in_file(data, "drawn.png")
    load_config(in_file(b"cameras: {left: {serial: A}}\ncontrol: {roi: {left: {mask: drawn.png}}}", "mask.yaml"))


@cache
def _mask() -> bytes:
    drawn = np.zeros((54, 72), np.uint8)
    drawn[:40] = 255
    return cv2.imencode(".png", drawn)[1].tobytes()


def mask_seeds() -> Iterator[bytes]:
    yield _mask()


def exposure_list(data: bytes) -> None:
    in_file(_mask(), "sweep/a.png")
    in_file(_mask(), "sweep/b.png")
    timed_files(in_file(data, "sweep/list.txt"))


def list_seeds() -> Iterator[bytes]:
    yield b"a.png 0.001\nb.png 1/500 # two\n"
    yield b"0.001\n0.002\n"


def image_file(data: bytes) -> None:
    """An image of a sweep, its time in EXIF or in its name."""
    read_images(in_file(data, "shot/img_500us.jpg").parent)


def image_file_seeds() -> Iterator[bytes]:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x829A: 0.01, 0x829D: 2.8, 0x8827: 100})
    for kind in ("JPEG", "TIFF", "PNG"):
        content = io.BytesIO()
        Image.fromarray(np.arange(48, dtype=np.uint8).reshape(6, 8)).save(content, kind, exif=exif)
        yield content.getvalue()


def last_exposure(data: bytes) -> None:
    LastExposure(in_file(data, "last.json")).recall(LIMITS)


def last_exposure_seeds() -> Iterator[bytes]:
    now = {"format": FORMAT, "unix_time_s": time.time(), "exposure_time_us": 1500.0, "gain_db": 3.0}
    yield json.dumps(now).encode()


CAMERAS = ("left", "right", "rear", "top")


def published(data: bytes) -> None:
    """Messages as a consumer receives them: of which camera and what says their first byte."""
    tally = ConsumerTally()
    assembler, queue = SetAssembler(ReceivedSet, tally), SetQueue[ReceivedSet](tally, 8)
    for message in unframed(data):
        about = message[0] if message else 0
        take = assembler.image if about & 1 else assembler.exposure
        whole = take(CAMERAS[about >> 1 & 3], message[1:], 0)
        if whole is not None:
            queue.put(whole)
            taken = queue.take()
            for frame in taken.frames.values():
                frame.grey8().mean()
                str(frame.setting)
            ExposureHistory().add(0.0, "all", taken.reference.setting, taken.decision)
    assert ConsumerTally.from_json(tally.to_json()) == tally  # what this consumer reports is a report


def received(sent: Iterable[Message]) -> bytes:
    """Messages as an input of `published`."""
    parts = []
    for message in sent:
        if message.topic != "camera_info":
            about = (message.topic == "image") | CAMERAS.index(message.camera) << 1
            parts.append(bytes([about]) + bytes(message.data))
    return framed(*parts)


def published_seeds() -> Iterator[bytes]:
    for rig in (CAMERAS[:1], CAMERAS[:2], CAMERAS[:3]):
        yield received(message for number in range(2) for message in messages(number, rig=rig))


def imu_seeds() -> Iterator[bytes]:
    yield imu_message((0.3, -0.4, 1.2))


def truth(data: bytes) -> None:
    read_pulses([in_file(data, "truth.jsonl")])


def truth_seeds() -> Iterator[bytes]:
    path = in_file(b"", "made.jsonl")
    file = TruthFile(path, lambda time_s: 150.0, Line0(0, 60.0))
    for pulse in range(3):
        file.record(pulse)
    file.close()
    yield path.read_bytes()


def tally(data: bytes) -> None:
    """A consumer's report, as far as the operator reads it."""
    counts = ConsumerTally.from_json(data)
    if counts is not None:
        consumers = Consumers()
        consumers.heard("slam", counts, 0)
        assert EXPOSING.publishing is not None
        show(replace(EXPOSING, publishing=replace(EXPOSING.publishing, consumers=dict(consumers.listed(0)))))


def show(status: Status) -> None:
    """A status wherever it is shown: terminal, log, metrics, page."""
    curves, table = Sparklines(), Table()
    for _ in range(2):
        curves.add(status)
    curves.add_rows(table, 80)
    panel_of(status, curves, 0.0, 50, 80)
    line_of(status)
    list(text_string_to_metric_families(exposition("rig", status).decode()))
    to_bytes(status, inf_nan_mode="null")


def status(data: bytes) -> None:
    """What a daemon says of itself."""
    said = Status.from_json(data)
    if said is not None:
        assert Status.from_json(said.to_json()) is not None
        show(said)


def status_seeds() -> Iterator[bytes]:
    yield EXPOSING.to_json().encode()


def control_request(data: bytes) -> None:
    """What is asked of a daemon, and what it makes of it."""
    request = read_request(data)
    assert read_request(request.to_json().encode()) == request
    assert str(request.words.encode())
    config = Config.model_validate({"cameras": {"left": {"serial": "A"}, "right": {"serial": "B"}}})
    Tuning(config).changed(request)


def control_request_seeds() -> Iterator[bytes]:
    yield b'{"by": "user@robot", "locked": true, "shot": {"exposure_time_us": 500, "gain_db": 3}}'
    region = b'{"left": {"rectangles": [{"box": [0, 0, 720, 270], "weight": 0.5}], "background_weight": 0.1}}'
    limits = b'{"min_time_us": 20, "max_time_us": 5000, "min_gain_db": 0, "max_gain_db": 20}'
    yield (
        b'{"by": "x", "reset": true, "ev_stops": -1.5, "policy": "begin2022", "limits": ' + limits
        + b', "region": ' + region + b"}"
    )  # fmt: skip


def control_answer(data: bytes) -> None:
    """What a daemon answers, as the terminal shows it."""
    answer = Answer.from_json(data)
    if answer is not None:
        rows_of(answer)
        assert str(answer.shot)


def control_answer_seeds() -> Iterator[bytes]:
    assert EXPOSING.requests is not None
    yield (
        Answer(DEFAULT_POLICY, EXPOSING.requests, AnsweredShot(ExposureSetting(500.0, 3.0), 7, {"left": 8}))
        .to_json()
        .encode()
    )


def grounds(data: bytes) -> None:
    """What a decision rests on, as the page draws it."""
    found = grounds_from_json(data)
    if found is not None:
        assert found.best_level in found.levels


def grounds_seeds() -> Iterator[bytes]:
    yield grounds_to_json(GROUNDS)
    yield grounds_to_json(None)


def published_response(data: bytes) -> None:
    """A camera's response function and vignetting, as the page and clients use them."""
    response, vignetting = response_from_json(data), vignetting_from_json(data)
    if vignetting is not None:
        vignetting.relative_light(72, 96)
    if response is not None:
        grey = np.arange(72 * 96, dtype=np.uint8).reshape(72, 96)
        maker, frame = PictureMaker(response), Frame(grey, 8, 0, 0, 0, 0, ExposureSetting(1.0, 0.0))
        maker.picture(frame)
        maker.curve(frame)


def published_response_seeds() -> Iterator[bytes]:
    yield response_to_json(ResponseFunction.linear()).encode()
    yield response_to_json(ResponseFunction.linear(), Vignetting(96, 72, (47.5, 35.5), (-0.5,))).encode()


def page_request(data: bytes) -> None:
    """A request's headers, a line each, to a page with a token and to one without."""
    headers = [(name.lower(), value.strip()) for name, _, value in (line.partition(b":") for line in data.splitlines())]
    for kind, key in (("http", None), ("http", Key("0123456789abcdef")), ("websocket", None)):
        scope = {"type": kind, "method": "GET", "path": "/", "query_string": data, "headers": headers}
        Access(PlainTextResponse("seen"), key).refusal(HTTPConnection(scope))


def page_request_seeds() -> Iterator[bytes]:
    yield b"host: 127.0.0.1:8420\norigin: http://127.0.0.1:8420\naccept: text/html\ncookie: autoexpose_page=00"
    yield b"host: [::1]:8420\nauthorization: Bearer 0123456789abcdef"


def tally_seeds() -> Iterator[bytes]:
    yield ConsumerTally(1, 2, 3, 4, 5).to_json().encode()


@cache
def _recording() -> bytes:
    """Three steps as our recorder writes them, and so without checksums and compression, which stop most damage."""
    path = in_file(b"", "run/made.mcap")
    path.unlink()
    record(path, _run(), 3)
    return path.read_bytes()


def _run() -> VirtualRun:
    return VirtualRun("neves2009", imu=True, steered=True, tracked=True)


def _bare(recording: bytes) -> bytes:
    """The same messages without checksums and compression, which would stop most damage before our own code."""
    bare = io.BytesIO()
    writer = Writer(bare, compression=CompressionType.NONE, enable_crcs=False, use_chunking=False)
    writer.start("ros2", "fuzz")
    channels: dict[int, int] = {}
    for schema, channel, message in make_reader(io.BytesIO(recording)).iter_messages():
        assert schema is not None
        if channel.id not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
    writer.finish()
    return bare.getvalue()


def recording(data: bytes) -> None:
    """Read and replayed."""
    for replayed in Replay().steps(Recording(in_file(data, "run/fuzzed.mcap"))):
        str(replayed.same)


def recording_seeds() -> Iterator[bytes]:
    yield _recording()
    yield _bare(_recording())


def control_setup(data: bytes) -> None:
    ControlLoop(parse(from_json(data.decode(errors="replace")), ControlSetup))


def setup_seeds() -> Iterator[bytes]:
    yield to_json(plain(_run().loop.setup)).encode()


def control_state(data: bytes) -> None:
    _run().loop.restore(from_json(data.decode(errors="replace")))


def state_seeds() -> Iterator[bytes]:
    run = _run()
    for _, pair in zip(range(3), run.pairs(), strict=False):
        run.loop.step(pair)
    yield to_json(run.loop.state()).encode()
