"""From messages back to frames and decisions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.types import CAMERA_INFO, ENCODINGS, EXPOSURE_INFO, IMAGE, IMU, TYPESTORE, to_full_scale
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.geometry import COEFFICIENTS, CameraGeometry
from imaging.pixels import SAMPLES, Layout, PixelFormat, Pixels

_KNOWN = {(row.bit_depth, row.layout, row.dtype) for row in PixelFormat}


class DamagedMessageError(ValueError):
    """Bytes that are not the message they should be."""


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedImage:
    """The content of an Image: its samples as they were sent, a read-only view of the message."""

    pixels: Pixels
    layout: Layout


def read_image(data: bytes) -> tuple[int, ReceivedImage]:
    """Stamp (CLOCK_REALTIME, ns) and content of an Image.

    Raises
    ------
    DamagedMessageError
        When its encoding is not one of `ENCODINGS`, or it is not complete.
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

    Raises
    ------
    DamagedMessageError
        When it is not a CameraInfo, or of a distortion that is not known.
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

    Raises
    ------
    DamagedMessageError
        When it is not an Imu, or measures no angular velocity, or no credible one.
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

    Raises
    ------
    DamagedMessageError
        When the two do not belong together, or no image can have been taken that way.
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
