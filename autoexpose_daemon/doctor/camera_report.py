"""What a camera is and does on this host, in a file to send to those who cannot try it themselves."""

from __future__ import annotations

import json
import platform
import re
import signal
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import typer
import yaml

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.doctor.facts import Facts, Need
from documents.command_line import CommandOutput, yaml_text
from documents.text import readable
from drivers.aravis import AravisCamera, FoundCamera, find_cameras, open_camera, open_nodes
from drivers.genicam.dialect import gain_driven
from drivers.genicam.features import advice, changed_from_default, differing, read_inventory
from drivers.genicam.nodes import NodeMap
from drivers.setup import CameraSetup, FeatureSetting, TriggerSetup, as_list
from imaging.errors import AutoexposeError, CameraLostError, ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame

_STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_NO_CONFIGURATION = CameraSetup(TriggerSetup("external"))


def show_features(serial: str, changed: bool, save: Path | None, output: CommandOutput) -> None:
    """Print what can be set on a camera, or what differs from its default user set, as a configuration; or save it.

    Features that the daemon drives itself are left out.

    Raises AutoexposeError if the camera is lost meanwhile, with features that could not be put back, and if `save`
    cannot be written.
    """
    with open_nodes(serial) as nodes:
        inventory = read_inventory(nodes)
        settings, lost = list(inventory.settings), list[FeatureSetting]()
        if changed:
            try:
                with _undisturbed():
                    settings, lost = changed_from_default(nodes, settings)
            except CameraLostError as error:
                raise CameraLostError(f"{error}; it may be left with its default user set") from error
        free = _free(nodes, settings)
    document = {"cameras": {"left": {"serial": serial, "features": as_list(free)}}}
    if save is None:
        output.show_yaml(document)
    else:
        _write(save, yaml_text(document))
        output.say(f"{save}: {len(free)} features of camera {serial}")
    _tell("driven by the daemon, so left out", [setting.name for setting in settings if setting not in free])
    _tell("cannot be read, so left out", inventory.unread)
    _tell("tables, so left out", inventory.tables)
    if changed:
        _tell("the default user set was loaded for a moment, which may have reset these tables", inventory.tables)
    if lost:
        raise AutoexposeError(
            f"camera {serial}: these could not be put back after its default user set was loaded: "
            f"{', '.join(f'{setting.key}: {setting.value}' for setting in lost)}; switch it off and on"
        )


def show_difference(serial: str, file: Path, output: CommandOutput) -> bool:
    """Print where a camera differs from the features of a configuration file; True if there is no difference."""
    config = load_config(file)
    camera = _name_of(serial, config, file)
    last = {feature.key: feature for feature in config.cameras[camera].features}  # of equal keys the last counts
    with open_nodes(serial) as nodes:
        settings = [feature for feature in last.values() if nodes.kind(feature.name) != "command"]
        found = differing(nodes, settings)
    output.document["differences"] = [
        {"feature": setting.key, "camera": present, "file": setting.value} for setting, present in found
    ]
    for setting, present in found:
        has = "cannot be read" if present is None else f"is {_value(present)}"
        output.say(f"{setting.key} {has}, in {file} {_value(setting.value)}")
    if not found:
        output.say(f"camera {serial} has all {len(settings)} features of cameras.{camera} in {file}")
    return not found


def _name_of(serial: str, config: Config, file: Path) -> CameraName:
    for name, camera in config.cameras.items():
        if camera.serial == serial:
            return name
    if len(config.cameras) == 1:  # the features of another camera, such as its twin
        return config.primary
    raise ConfigurationError(f"{file}: no camera is {serial}: name a file with that camera, or with a single one")


def _free(nodes: NodeMap, settings: Sequence[FeatureSetting]) -> list[FeatureSetting]:
    """The features that the daemon does not drive."""
    driven = gain_driven(nodes)
    return [setting for setting in settings if advice(setting, _NO_CONFIGURATION, driven) is None]


def _write(file: Path, text: str) -> None:
    try:
        with file.open("x") as new:
            new.write(text)
    except OSError as error:
        raise AutoexposeError(f"{file}: cannot be written ({error.strerror}): name a new file") from error


def _value(value: object) -> str:
    return yaml.safe_dump(value).removesuffix("...\n").strip()


def _tell(what: str, names: Sequence[str]) -> None:
    if names:
        typer.echo(readable(f"{what}: {', '.join(dict.fromkeys(names))}"), err=True)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Ctrl-C, SIGTERM and a closed terminal wait: the camera must not be left with its default user set."""
    came: list[int] = []
    former = {one: signal.signal(one, lambda number, _: came.append(number)) for one in _STOPPING}
    try:
        yield
    finally:
        for one, handler in former.items():
            signal.signal(one, handler)
        if came:
            signal.raise_signal(came[0])


FORMAT = "autoexpose-camera-report/1"
WATCHED_S: Final = 20.0
_RATE_HZ: Final = 30.0
_PATIENCE_S: Final = 0.5
_WRITE_EVERY_S: Final = 0.2
_TIMES_US: Final = (2000.0, 1000.0)
"""Written in turn; both leave room for the frame rate."""
_IPV4: Final = re.compile(r"\b\d{1,3}(?:\.\d{1,3}){3}\b")


def write_report(
    path: Path, facts: Facts, need: Need, say: Callable[[str], None], watched_s: float = WATCHED_S
) -> None:
    """Let each needed camera run freely for a while, and write the report: no images, addresses or serial numbers.

    Raises ConfigurationError when the file exists, or cannot be written.
    """
    found = [camera for camera in find_cameras() if need.wants(camera.serial)]
    ours, python = version("autoexpose-daemon"), platform.python_version()
    software = {"autoexpose-daemon": ours, "python": python, "system": platform.platform()}
    host = json.dumps({"format": FORMAT, "software": software, "host": _host(facts)}, indent=1)
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
    newest: Frame | None = None
    starts_ms, late_ms, write_ms = list[float](), list[float](), list[float]()  # late: from exposure to memory
    incomplete, ids, doubts, limits = 0, list[int](), list[str](), camera.limits
    camera.start()
    end_s = written_s = time.monotonic() + watched_s
    written_s -= watched_s
    while (now_s := time.monotonic()) < end_s:
        if now_s >= written_s:
            written_s += _WRITE_EVERY_S
            time_us = min(max(_TIMES_US[len(write_ms) % 2], limits.min_time_us), limits.max_time_us)
            camera.write(ExposureSetting(time_us, limits.min_gain_db))
            write_ms.append(1e3 * (time.monotonic() - now_s))
        frame = camera.next_frame(_PATIENCE_S)
        if frame is None:
            continue
        ids.append(frame.frame_id)
        if isinstance(frame, Frame):
            newest, taken_us = frame, frame.setting.exposure_time_us
            doubts += [] if frame.clock_trouble is None else [frame.clock_trouble.sentence]
            starts_ms.append(frame.device_time_ns * 1e-6)
            late_ms.append((frame.arrival_time_ns - frame.host_time_ns) * 1e-6 - 1e-3 * taken_us)
        else:
            incomplete += 1
    if newest is None:
        return {"frames": 0, "incomplete": incomplete}
    return {
        "frames": len(starts_ms),
        "incomplete": incomplete,
        "doubts": doubts,
        "missing_ids": max(ids) - min(ids) + 1 - len(ids),
        "frame_shape": list(newest.pixels.shape),
        "setting_source": newest.setting_source,
        "asked_hz": _RATE_HZ,
        "between_starts_ms": _percentiles(np.diff(starts_ms)),
        "exposure_end_to_arrival_ms": _percentiles(np.array(late_ms)),
        "write_ms": _percentiles(np.array(write_ms)),
    }


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
