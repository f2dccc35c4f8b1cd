"""From a stereo pair and its decision to messages."""

from __future__ import annotations

import math
import time
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.types import CAMERA_INFO, EXPOSURE_INFO, IMAGE, TYPESTORE, encoding, to_full_scale
from imaging.frames import SIDES, Frame, Side, StereoPair
from imaging.geometry import CameraGeometry
from imaging.pixels import SAMPLES

if TYPE_CHECKING:
    from imaging.frames import Frame

Stamp = Literal["start", "middle", "end"]

_SHARES: dict[Stamp, float] = {"start": 0.0, "middle": 0.5, "end": 1.0}


def moment_ns(frame: Frame, stamp: Stamp) -> int:
    """That moment, CLOCK_MONOTONIC. A moving object is seen where it is in the middle of the exposure."""
    return frame.host_time_ns + round(1e3 * _SHARES[stamp] * frame.setting.exposure_time_us)


TOPICS = {"image": IMAGE, "camera_info": CAMERA_INFO, "exposure": EXPOSURE_INFO}
"""The messages for each frame: the last part of the key, and the message type."""

ALL_TOPICS: Final = frozenset((side, topic) for side in SIDES for topic in TOPICS)

_UNCALIBRATED: Final[Mapping[Side, CameraGeometry]] = {}

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

    side: Side
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
    """Makes the messages of a rig, in the order in which to send them.

    Parameters
    ----------
    rig
        Name of the rig; coordinate frames are named after it, as in ``rig_left_optical_frame``.
    cameras
        How many cameras the rig has.
    stamp
        The moment of the left frame's exposure that messages carry.
    """

    def __init__(self, rig: str, cameras: int, stamp: Stamp = "middle") -> None:
        self._rig = rig
        self._stamp = stamp
        self._cameras = cameras

    def messages(
        self,
        pair: StereoPair,
        decision: Decision | None,
        sequence: int,
        offset_ns: int,
        wanted: Container[tuple[Side, str]] = ALL_TOPICS,
        *,
        calibrations: Mapping[Side, CameraGeometry] = _UNCALIBRATED,
    ) -> Iterator[Message]:
        """The messages of one pair; None: nothing was decided on it.

        Parameters
        ----------
        sequence
            Number of this pair among those sent, or recorded.
        offset_ns
            CLOCK_REALTIME minus CLOCK_MONOTONIC, as `realtime_offset_ns` measures it.
        wanted
            Side and topic of the messages to make.
        calibrations
            The geometry of the cameras that are calibrated.
        """
        stamp_ns = min(max(moment_ns(pair.reference, self._stamp) + offset_ns, 0), LAST_STAMP_NS)
        stamp = _Time(*divmod(stamp_ns, 1_000_000_000))
        of_pair: dict[str, float | str] = {
            "trigger": pair.trigger,
            "sequence": sequence,
            "cameras": self._cameras,
            "alone": len(pair.frames) < self._cameras,
            **(_NOTHING_DECIDED if decision is None else _of_decision(decision)),
        }
        for side, frame in pair.frames.items():
            header = _Header(stamp, f"{self._rig}_{side}_optical_frame")
            info = _ExposureInfo(header=header, **of_pair, **_of_frame(frame))
            if (side, "exposure") in wanted:
                yield Message(side, "exposure", _serialise(info, EXPOSURE_INFO))
            if (side, "camera_info") in wanted:
                geometry = calibrations.get(side)
                yield Message(side, "camera_info", _serialise(_camera_info(header, frame, geometry), CAMERA_INFO))
            if (side, "image") in wanted:
                yield Message(side, "image", _serialise(_image(header, frame), IMAGE))


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
    return {
        "frame_id": frame.frame_id,
        "device_time_ns": frame.device_time_ns,
        "host_time_ns": frame.host_time_ns,
        "arrival_time_ns": frame.arrival_time_ns,
        "bit_depth": frame.bit_depth,
        "exposure_time_us": frame.setting.exposure_time_us,
        "gain_db": frame.setting.gain_db,
        "exposure_level": frame.setting.level,
        "setting_source": frame.setting_source,
    }


_NOTHING_DECIDED: dict[str, float | str] = {
    "next_exposure_time_us": math.nan,
    "next_gain_db": math.nan,
    "next_exposure_level": math.nan,
    "reason": "",
    "metric": math.nan,
    "saturated_share": math.nan,
    "black_share": math.nan,
    "motion_px": math.nan,
}


def _of_decision(decision: Decision) -> dict[str, float | str]:
    return {
        "next_exposure_time_us": decision.setting.exposure_time_us,
        "next_gain_db": decision.setting.gain_db,
        "next_exposure_level": decision.level,
        "reason": decision.reason,
        "metric": math.nan if decision.metric is None else decision.metric,
        "saturated_share": decision.saturated_share,
        "black_share": decision.black_share,
        "motion_px": decision.motion_px,
    }
