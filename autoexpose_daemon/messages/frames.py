"""From a set of frames and what was decided on it to messages, and back."""

from __future__ import annotations

import math
import time
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.types import (
    CAMERA_INFO,
    ENCODINGS,
    EXPOSURE_INFO,
    IMAGE,
    IMU,
    TYPESTORE,
    encoding,
    to_full_scale,
)
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import COEFFICIENTS, CameraGeometry
from imaging.pixels import SAMPLES, Layout, PixelFormat, Pixels

Moment = Literal["start", "middle", "end"]

_SHARES: dict[Moment, float] = {"start": 0.0, "middle": 0.5, "end": 1.0}


@dataclass(frozen=True, slots=True)
class Stamping:
    """What messages are stamped with: a moment of the first camera's exposure, on a clock.

    A moving object is seen where it is in the middle of the exposure. The clock is CLOCK_REALTIME, or with
    `ptp_utc_offset_s` PTP time less so many seconds, for frames that have one.
    """

    moment: Moment = "middle"
    ptp_utc_offset_s: int | None = None

    def moment_ns(self, frame: Frame) -> int:
        """That moment, CLOCK_MONOTONIC."""
        return frame.host_time_ns + round(1e3 * _SHARES[self.moment] * frame.setting.exposure_time_us)

    def ptp_ahead_ns(self, frame: Frame) -> int | None:
        """What the clock of a frame's stamp is ahead of CLOCK_MONOTONIC, if it is PTP's; None: it is CLOCK_REALTIME."""
        if self.ptp_utc_offset_s is None or frame.ptp_time_ns is None:
            return None
        return frame.ptp_time_ns - frame.host_time_ns - self.ptp_utc_offset_s * 1_000_000_000


MIDDLE = Stamping()


TOPICS = {"image": IMAGE, "camera_info": CAMERA_INFO, "exposure": EXPOSURE_INFO}
"""The messages for each frame: the last part of the key, and the message type."""

LAST_STAMP_NS = (1 << 31) * 1_000_000_000 - 1
"""The end of ROS 2's time, in 2038: a camera with a wild clock must not stop the sending of its frames."""

_CLOCK_TRIES = 3

_types = TYPESTORE.types
_Time, _Header = _types["builtin_interfaces/msg/Time"], _types["std_msgs/msg/Header"]
_Image, _CameraInfo, _ExposureInfo = _types[IMAGE], _types[CAMERA_INFO], _types[EXPOSURE_INFO]
_no_region = _types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)


@dataclass(frozen=True, slots=True)
class Message:
    """One message: its camera, which of `TOPICS` it is, and its CDR bytes."""

    camera: CameraName
    topic: str
    data: bytearray


def realtime_offset_ns() -> int:
    """What to add to CLOCK_MONOTONIC to get CLOCK_REALTIME, ns: the quickest of a few looks at both clocks.

    It is constant except for steps of CLOCK_REALTIME, so stamps step when the machine's clock does, and otherwise
    follow it.
    """

    def look() -> tuple[int, int]:
        before_ns = time.monotonic_ns()
        realtime_ns = time.time_ns()
        took_ns = time.monotonic_ns() - before_ns
        return took_ns, realtime_ns - before_ns - took_ns // 2

    return min(look() for _ in range(_CLOCK_TRIES))[1]


class MessageWriter:
    """Makes the messages of a rig of so many cameras, in the order in which to send them.

    Coordinate frames are named after the rig, as in ``rig_left_optical_frame``.
    """

    def __init__(self, rig: str, cameras: int, stamping: Stamping = MIDDLE) -> None:
        self._rig = rig
        self._stamping = stamping
        self._cameras = cameras

    def messages(
        self,
        pair: FrameSet,
        decisions: Mapping[CameraName, Decision],
        sequence: int,
        offset_ns: int,
        wanted: Container[tuple[CameraName, str]] | None = None,
        *,
        calibrations: Mapping[CameraName, CameraGeometry] = MappingProxyType({}),
    ) -> Iterator[Message]:
        """The messages of one set that are `wanted`, None: all; without decisions nothing was decided on it.

        `sequence` is its number among those sent, or recorded, `offset_ns` what `realtime_offset_ns` measures;
        `calibrations` are of the cameras that are calibrated.
        """
        ahead_ns = self._stamping.ptp_ahead_ns(pair.reference)
        ahead_ns = offset_ns if ahead_ns is None else ahead_ns
        stamp_ns = min(max(self._stamping.moment_ns(pair.reference) + ahead_ns, 0), LAST_STAMP_NS)
        stamp = _Time(*divmod(stamp_ns, 1_000_000_000))
        of_pair: dict[str, float | str] = {
            "trigger": pair.trigger,
            "sequence": sequence,
            "cameras": self._cameras,
            "alone": len(pair.frames) < self._cameras,
        }
        for camera, frame in pair.frames.items():
            header = _Header(stamp, f"{self._rig}_{camera}_optical_frame")
            of_frame = _of_decision(decisions.get(camera)) | _of_frame(frame)
            info = _ExposureInfo(header=header, **of_pair, **of_frame)
            if wanted is None or (camera, "exposure") in wanted:
                yield Message(camera, "exposure", _serialise(info, EXPOSURE_INFO))
            if wanted is None or (camera, "camera_info") in wanted:
                geometry = calibrations.get(camera)
                yield Message(camera, "camera_info", _serialise(_camera_info(header, frame, geometry), CAMERA_INFO))
            if wanted is None or (camera, "image") in wanted:
                yield Message(camera, "image", _serialise(_image(header, frame), IMAGE))


def _serialise(message: object, message_type: str) -> bytearray:
    """The bytes that were written, not a copy of them."""
    data = TYPESTORE.serialize_cdr(message, message_type).obj
    assert isinstance(data, bytearray)
    return data


def _image(header: Any, frame: Frame) -> Any:
    height, width = frame.pixels.shape[:2]
    shift = to_full_scale(frame.bit_depth)
    data = (frame.pixels << shift if shift else frame.pixels).reshape(-1).view(np.uint8)
    row_bytes = width * SAMPLES.get(frame.layout, 1) * frame.pixels.itemsize
    return _Image(header, height, width, encoding(frame.layout, frame.pixels.dtype), 0, row_bytes, data)


def _camera_info(header: Any, frame: Frame, geometry: CameraGeometry | None) -> Any:
    """By the message's convention, K is zero if the camera is not calibrated for frames of this size."""
    height, width = frame.pixels.shape[:2]
    if geometry is None or (geometry.width, geometry.height) != (width, height):
        none, k, p = np.zeros(0), np.zeros(9), np.zeros(12)
        return _CameraInfo(header, height, width, "", none, k, k, p, 0, 0, _no_region)
    d, k, r, p = map(
        np.array, (geometry.distortion, geometry.camera_matrix, geometry.rectification, geometry.projection)
    )
    return _CameraInfo(header, height, width, geometry.distortion_model, d, k, r, p, 0, 0, _no_region)


def _of_frame(frame: Frame) -> dict[str, float | str]:
    names = ("frame_id", "device_time_ns", "host_time_ns", "arrival_time_ns", "bit_depth", "setting_source")
    return {name: getattr(frame, name) for name in names} | {
        "exposure_time_us": frame.setting.exposure_time_us,
        "gain_db": frame.setting.gain_db,
        "exposure_level": frame.setting.level,
    }


def _of_decision(decision: Decision | None) -> dict[str, float | str]:
    if decision is None:
        return dict.fromkeys(_OF_DECISION, math.nan) | {"reason": ""}
    setting, metric = decision.setting, math.nan if decision.metric is None else decision.metric
    shares = decision.saturated_share, decision.black_share
    values = setting.exposure_time_us, setting.gain_db, decision.level, metric, *shares, decision.motion_px
    return dict(zip(_OF_DECISION, values, strict=True)) | {"reason": decision.reason}


_OF_DECISION = (
    "next_exposure_time_us", "next_gain_db", "next_exposure_level", "metric", "saturated_share", "black_share",
    "motion_px",
)  # fmt: skip


_KNOWN = {(row.bit_depth, row.layout, row.dtype) for row in PixelFormat}


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedImage:
    """The content of an Image: its samples as they were sent, a read-only view of the message."""

    pixels: Pixels
    layout: Layout


def read_image(data: bytes) -> tuple[int, ReceivedImage]:
    """Stamp (CLOCK_REALTIME, ns) and content of an Image.

    Raises DamagedMessageError when its encoding is not one of `ENCODINGS`, or it is not complete.
    """
    message = deserialise(data, IMAGE)
    if message.encoding not in ENCODINGS or message.data.size != message.height * message.step:
        raise DamagedMessageError(f"an Image of {message.data.size} bytes, {message.height} rows, {message.encoding}")
    if message.data.size == 0:
        raise DamagedMessageError(f"an Image of {message.width}x{message.height} pixels")
    layout, dtype = ENCODINGS[message.encoding]
    samples = SAMPLES.get(layout, 1)
    if message.step != message.width * samples * dtype.itemsize or message.is_bigendian:
        raise DamagedMessageError(f"an Image of {message.width} pixels in rows of {message.step} bytes")
    if layout == "YUYV" and message.width % 2:
        raise DamagedMessageError(f"an Image of {message.width} pixels in a row, {message.encoding}")
    shape = (message.height, message.width, samples) if samples > 1 else (message.height, message.width)
    return stamp_ns(message), ReceivedImage(message.data.view(dtype).reshape(shape), layout)


def read_exposure_info(data: bytes) -> Any:
    """An ExposureInfo, with the fields of `ExposureInfo.msg`; raises `DamagedMessageError`."""
    return deserialise(data, EXPOSURE_INFO)


def read_camera_info(data: bytes) -> CameraGeometry | None:
    """The geometry in a CameraInfo; None of a camera that is not calibrated.

    Raises DamagedMessageError when it is not a CameraInfo, or of a distortion that is not known.
    """
    message = deserialise(data, CAMERA_INFO)
    if not message.k[0]:
        return None
    if len(message.d) != COEFFICIENTS.get(message.distortion_model):
        raise DamagedMessageError(f"{len(message.d)} coefficients of the distortion {message.distortion_model!r:.40}")
    d, k, r, p = (
        tuple(float(number) for number in numbers) for numbers in (message.d, message.k, message.r, message.p)
    )
    return CameraGeometry(message.width, message.height, message.distortion_model, d, k, r, p)


def read_angular_rate(data: bytes) -> float:
    """How fast the sensor of an Imu turns, about any axis, rad/s.

    Raises DamagedMessageError when it is not an Imu, or measures no angular velocity, or no credible one.
    """
    message = deserialise(data, IMU)
    if message.angular_velocity_covariance[0] == -1:  # by the message's convention
        raise DamagedMessageError("an Imu that measures no angular velocity")
    velocity = message.angular_velocity
    rate = math.hypot(velocity.x, velocity.y, velocity.z)
    if not rate <= FASTEST_TURN_RAD_S:
        raise DamagedMessageError(f"an Imu that turns at {rate:g} rad/s")
    return rate


def stamp_ns(message: Any) -> int:
    """The stamp of a message's header, CLOCK_REALTIME, ns."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def frame_of(info: Any, image: ReceivedImage, *, full_scale: bool = True) -> Frame:
    """The frame that an ExposureInfo and its Image describe.

    Without `full_scale`, deep samples are not shifted, as in old recordings.

    Raises DamagedMessageError when the two do not belong together, or no image can have been taken that way.
    """
    pixels = image.pixels
    if (info.bit_depth, image.layout, pixels.dtype) not in _KNOWN:
        raise DamagedMessageError(
            f"{info.bit_depth} significant bits in samples of {8 * pixels.itemsize}, {image.layout}"
        )
    shift = to_full_scale(info.bit_depth)
    if shift and full_scale:
        if (pixels & ((1 << shift) - 1)).any():
            raise DamagedMessageError(f"an Image that is not {info.bit_depth} bits shifted to full scale")
        pixels = np.right_shift(pixels, shift, dtype=np.uint16)
        pixels.setflags(write=False)
    elif shift and (pixels >> info.bit_depth).any():
        raise DamagedMessageError(f"an Image of more than {info.bit_depth} bits")
    return Frame(
        pixels,
        info.bit_depth,
        info.frame_id,
        info.device_time_ns,
        info.host_time_ns,
        info.arrival_time_ns,
        _setting(info.exposure_time_us, info.gain_db),
        "chunk" if info.setting_source == "chunk" else "ledger",
        image.layout,
    )


def decision_of(info: Any) -> Decision | None:
    """The decision in an ExposureInfo, if there was one; raises `DamagedMessageError`."""
    if not info.reason:
        return None
    return Decision(
        _setting(info.next_exposure_time_us, info.next_gain_db),
        info.next_exposure_level,
        info.reason,
        None if math.isnan(info.metric) else info.metric,
        info.saturated_share,
        info.black_share,
        info.motion_px,
    )


def _setting(exposure_time_us: float, gain_db: float) -> ExposureSetting:
    setting = ExposureSetting(exposure_time_us, gain_db)
    if not setting.is_physical:
        raise DamagedMessageError(f"an exposure of {exposure_time_us} us and {gain_db} dB")
    return setting


def deserialise(data: bytes, message_type: str) -> Any:
    """A message of any type; raises `DamagedMessageError`."""
    try:
        return TYPESTORE.deserialize_cdr(data, message_type)
    except Exception as error:  # rosbags checks nothing: what breaks depends on where the bytes are wrong
        raise DamagedMessageError(f"not a {message_type}: {error}") from error
