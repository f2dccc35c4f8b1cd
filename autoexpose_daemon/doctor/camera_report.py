"""What a camera is and does on this host, in a file to send to those who cannot try it themselves."""

from __future__ import annotations

import json
import platform
import re
import time
import zipfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from autoexpose_daemon.doctor.facts import Facts
from autoexpose_daemon.doctor.need import Need
from drivers.aravis import AravisCamera, FoundCamera, find_cameras, open_camera
from drivers.setup import CameraSetup, TriggerSetup
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, SettingSource

FORMAT = "autoexpose-camera-report/1"
WATCHED_S: Final = 20.0
_RATE_HZ: Final = 30.0
_PATIENCE_S: Final = 0.5
_WRITE_EVERY_S: Final = 0.2
_TIMES_US: Final = (2000.0, 1000.0)
"""Written in turn; both leave room for the frame rate."""
_IPV4: Final = re.compile(r"\b\d{1,3}(?:\.\d{1,3}){3}\b")


class Seen(NamedTuple):
    """What is kept of a frame: its start by the camera's clock, and how long after its exposure it was in memory."""

    start_ms: float
    late_ms: float
    setting_source: SettingSource


def write_report(
    path: Path, facts: Facts, need: Need, say: Callable[[str], None], watched_s: float = WATCHED_S
) -> None:
    """Let each needed camera run freely for a while, and write the report: no images, addresses or serial numbers.

    Raises
    ------
    ConfigurationError
        When the file exists, or cannot be written.
    """
    found = [camera for camera in find_cameras() if need.wants(camera.serial)]
    host = json.dumps({"format": FORMAT, "software": _software(), "host": _host(facts)}, indent=1)
    try:
        with zipfile.ZipFile(path, "x", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("host.json", host)
            for number, camera in enumerate(found, 1):
                say(f"{camera.vendor} {camera.model}: running freely for {watched_s:g} s ...")
                about, description = _examined(camera, watched_s)
                say(_in_words(about))
                archive.writestr(f"camera{number}/camera.json", json.dumps(about, indent=1))
                if description:
                    archive.writestr(f"camera{number}/description.xml", description)
    except OSError as error:
        reason = "it exists: name a new file" if isinstance(error, FileExistsError) else error.strerror
        raise ConfigurationError(f"--report {path}: {reason}") from error
    say(f"{path}: {len(found)} camera{'' if len(found) == 1 else 's'}; no images, addresses or serial numbers")


def _software() -> dict[str, str]:
    return {
        "autoexpose-daemon": version("autoexpose-daemon"),
        "python": platform.python_version(),
        "system": platform.platform(),
    }


def _host(facts: Facts) -> dict[str, Any]:
    interfaces = {camera.interface.name: camera.interface for camera in facts.gige.cameras}
    return {
        "network_interfaces": [
            {"mtu_bytes": each.mtu_bytes, "speed_mbps": each.speed_mbps} for each in interfaces.values()
        ],
        "largest_socket_buffer_bytes": facts.gige.largest_socket_buffer_bytes,
        "usb_speeds_mbps": [camera.speed_mbps for camera in facts.usb.cameras],
    }


def _examined(found: FoundCamera, watched_s: float) -> tuple[dict[str, Any], str]:
    """What the report says about a camera, and its GenICam description."""
    about: dict[str, Any] = {"vendor": found.vendor, "model": found.model, "transport": found.transport}
    try:
        camera = open_camera(found.serial, CameraSetup(TriggerSetup("free_run", rate_hz=_RATE_HZ)))
    except AutoexposeError as error:
        return about | {"not_opened": _anonymous(str(error), found)}, ""
    try:
        limits, pixel_format = camera.limits, camera.description.pixel_format
        about |= {
            "limitations": [_anonymous(text, found) for text in camera.description.limitations],
            "pixel_format": None if pixel_format is None else pixel_format.value,
            "exposure_time_us": [limits.min_time_us, limits.max_time_us, limits.time_step_us],
            "gain_db": [limits.min_gain_db, limits.max_gain_db, limits.gain_step_db],
        }
        about |= _watched(camera, watched_s)
        return about, camera.description_xml
    except AutoexposeError as error:
        return about | {"failed": _anonymous(str(error), found)}, camera.description_xml
    finally:
        camera.close()


def _anonymous(text: str, found: FoundCamera) -> str:
    """Without addresses and serial number; Aravis gives USB cameras the address "USB3", which may stay."""
    return _IPV4.sub("A", text).replace(found.serial, "S")


def _watched(camera: AravisCamera, watched_s: float) -> dict[str, Any]:
    """What the camera sends while its exposure time is written five times a second."""
    frames: list[Seen] = []
    write_ms: list[float] = []
    incomplete, shape = 0, ()
    ids: list[int] = []
    doubts: list[str] = []
    camera.start()
    end_s = written_s = time.monotonic() + watched_s
    written_s -= watched_s
    while (now_s := time.monotonic()) < end_s:
        if now_s >= written_s:
            written_s += _WRITE_EVERY_S
            camera.write(_setting(camera.limits, _TIMES_US[len(write_ms) % 2]))
            write_ms.append(1e3 * (time.monotonic() - now_s))
        frame = camera.next_frame(_PATIENCE_S)
        if frame is None:
            continue
        ids.append(frame.frame_id)
        if isinstance(frame, Frame):
            shape = frame.pixels.shape
            taken_us = frame.setting.exposure_time_us
            late_ms = (frame.arrival_time_ns - frame.host_time_ns) * 1e-6 - 1e-3 * taken_us
            doubts += [] if frame.doubt is None else [frame.doubt.sentence]
            frames.append(Seen(frame.device_time_ns * 1e-6, late_ms, frame.setting_source))
        else:
            incomplete += 1
    if not frames:
        return {"frames": 0, "incomplete": incomplete}
    return {
        "frames": len(frames),
        "incomplete": incomplete,
        "doubts": doubts,
        "missing_ids": max(ids) - min(ids) + 1 - len(ids),
        "frame_shape": list(shape),
        "setting_source": frames[-1].setting_source,
        "asked_hz": _RATE_HZ,
        "between_starts_ms": _percentiles(np.diff([frame.start_ms for frame in frames])),
        "exposure_end_to_arrival_ms": _percentiles(np.array([frame.late_ms for frame in frames])),
        "write_ms": _percentiles(np.array(write_ms)),
    }


def _setting(limits: ExposureLimits, time_us: float) -> ExposureSetting:
    return ExposureSetting(min(max(time_us, limits.min_time_us), limits.max_time_us), limits.min_gain_db)


def _percentiles(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float] | None:
    if not values.size:
        return None
    return {f"p{share}": round(float(np.percentile(values, share)), 3) for share in (1, 50, 99)}


def _in_words(about: dict[str, Any]) -> str:
    if "not_opened" in about or "failed" in about:
        return f"  {about.get('not_opened') or about['failed']}"
    if not about["frames"]:
        incomplete = about["incomplete"]
        return f"  no whole frame arrived, {incomplete} incomplete ones did" if incomplete else "  no frames arrived"
    return (
        f"  {about['frames']} frames, {about['incomplete']} incomplete, {about['missing_ids']} missing; "
        f"{about['exposure_end_to_arrival_ms']['p50']:.1f} ms from the end of exposure to memory, "
        f"{about['write_ms']['p50']:.1f} ms for a write"
    )
