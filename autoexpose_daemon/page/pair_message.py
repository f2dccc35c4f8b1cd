"""One pair in a message to a browser."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from pydantic_core import to_json

from autoexpose_daemon.client import ReceivedPair
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.registration import RegisteredView
from autoexpose_daemon.page.picture import Picture
from imaging.frames import Frame, Side


def pair_message(
    pair: ReceivedPair, pictures: Mapping[Side, Picture], registered: RegisteredView | None = None
) -> bytes:
    """Length of the text (4 bytes, little-endian), the text in JSON, then the JPEGs in its order."""
    frames = pair.stereo.frames
    text = {
        "trigger": pair.trigger,
        "pictures": [_described(side, frames[side], picture) for side, picture in pictures.items()],
        "decision": None if pair.decision is None else _decided(pair.decision),
        "registered": None if registered is None else _registered(registered),
    }
    head = to_json(text, inf_nan_mode="null")
    return b"".join([struct.pack("<I", len(head)), head, *(picture.jpeg for picture in pictures.values())])


def _described(side: Side, frame: Frame, picture: Picture) -> dict[str, Any]:
    return {
        "side": side,
        "jpeg_bytes": len(picture.jpeg),
        "frame_width": picture.width,
        "exposure_time_us": frame.setting.exposure_time_us,
        "gain_db": frame.setting.gain_db,
        "metric": picture.metric,
        "saturated_share": picture.saturated_share,
        "black_share": picture.black_share,
    }


def _decided(decision: Decision) -> dict[str, Any]:
    return {
        "reason": decision.reason,
        "exposure_time_us": decision.setting.exposure_time_us,
        "gain_db": decision.setting.gain_db,
        "level": decision.level,
        "metric": decision.metric,
        "saturated_share": decision.saturated_share,
        "black_share": decision.black_share,
        "motion_px": decision.motion_px,
    }


def _registered(view: RegisteredView) -> dict[str, Any]:
    return {
        "distance_m": view.distance_m,
        "length_m": view.length_m,
        "local_map": view.local_map,
        "shift_px": view.shift_px,
        "matches": [view.x_px.tolist(), view.y_px.tolist(), view.shifts_px.tolist(), view.agreed.tolist()],
        "forward_m_s": view.forward_m_s,
        "turn_rad_s": view.turn_rad_s,
        "stopped": view.stopped,
    }
