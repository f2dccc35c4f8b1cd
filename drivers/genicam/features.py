"""Setting any features of a camera, in a given order, and reading back what it is set to."""

from __future__ import annotations

import contextlib
import difflib
import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from drivers.genicam.dialect import GAINS, RAW_TIME, SWITCHES, TIME_NODES, gain_driven
from drivers.genicam.nodes import SWITCHED, NodeMap, hold, is_number, offered, read_feature
from drivers.genicam.trigger import ACTION_NODES, PTP_SWITCHES, RATE_NODES, RATE_SWITCHES, SOFTWARE_TRIGGER
from drivers.setup import EXECUTE, CameraSetup, FeatureSetting, FeatureValue, misfit
from imaging.errors import AutoexposeError, ConfigurationError, NodeError, UnsupportedCameraError

log = logging.getLogger(__name__)

_DRIVEN = "the daemon drives it: "
_TIME = f"{_DRIVEN}set exposure.min_time_us and exposure.max_time_us instead"
_GAIN = f"{_DRIVEN}set exposure.min_gain_db and exposure.max_gain_db instead"
_RATE = f"{_DRIVEN}set trigger.rate_hz instead"
_REMOVE = f"{_DRIVEN}remove it"

_ALWAYS = {
    **dict.fromkeys((*TIME_NODES, RAW_TIME, "ExposureMode", "ExposureAuto"), _TIME),
    "GainAuto": _GAIN,
    "BalanceWhiteAuto": "it stays Off, so that the colours keep their proportions: remove it",
    **dict.fromkeys((*SWITCHES, "Gamma"), "gamma is off, so that grey levels are proportional to light: remove it"),
    "TriggerMode": f"{_DRIVEN}set trigger.mode instead",
    "TriggerSource": f"{_DRIVEN}set trigger.mode and trigger.line instead",
    "TriggerActivation": f"{_DRIVEN}for falling edges set LineInverter of the trigger's line instead",
    "TriggerOverlap": _REMOVE,
    **dict.fromkeys((*RATE_SWITCHES, "AcquisitionFrameRateAuto"), _RATE),
    "PixelFormat": f"{_DRIVEN}set image.pixel_format instead",
    **dict.fromkeys(("ChunkModeActive", "ChunkEnable"), _REMOVE),
    "GevSCPSPacketSize": f"{_DRIVEN}set transport.packet_size_bytes instead",
    **dict.fromkeys(("GevCCP", "GevSCPHostPort", "GevSCDA", "TLParamsLocked"), _REMOVE),
    **dict.fromkeys(("AcquisitionMode", "AcquisitionStart", "AcquisitionStop", "AcquisitionAbort"), _REMOVE),
    "DeviceReset": "the camera would restart whenever it is opened: remove it",
    "UserSetSave": "it would wear out the camera's memory whenever it is opened: save once, with the maker's program",
}
"""Advice by the name of each feature that is driven on every camera, here or by Aravis for the stream, or harmful."""
_BINNED = ("BinningHorizontal", "BinningVertical", "Width", "Height", "OffsetX", "OffsetY")
_SHARE = ("GevSCPD", "DeviceLinkThroughputLimit", "DeviceLinkThroughputLimitMode")
_OUTPUT = ("LineMode", "LineSource")


def refuse_driven(setup: CameraSetup, gain_driven: bool = False) -> Iterator[ConfigurationError]:
    """What is wrong with each feature of a setup that the daemon drives itself.

    A gain that is not in dB is driven only with a scale: `gain_driven` says whether the camera's is in dB, False if
    that is not known.
    """
    for feature in setup.features:
        words = advice(feature, setup, gain_driven)
        if words is not None:
            yield ConfigurationError(f"{feature.key} cannot be set here: {words}")


def advice(feature: FeatureSetting, setup: CameraSetup, gain_driven: bool) -> str | None:
    """What to do instead of setting a feature; None for one that is free."""
    if feature.name in _ALWAYS:
        return _ALWAYS[feature.name]
    trigger, line = setup.trigger, feature.entry("LineSelector")
    own_rate = trigger.mode == "free_run" and trigger.rate_hz is not None
    own_line = trigger.output_line is not None and line in (None, trigger.output_line)
    driven = [
        (_GAIN, GAINS, gain_driven or setup.gain_scale is not None),
        (_RATE, RATE_NODES, own_rate),
        (_REMOVE, (SOFTWARE_TRIGGER,), trigger.mode == "software"),
        (_REMOVE, (*PTP_SWITCHES, *ACTION_NODES), trigger.mode == "ptp"),
        (f"{_DRIVEN}set trigger.output_line instead", _OUTPUT, own_line),
        ("image.binning sets it: remove that, or this", _BINNED, setup.binning is not None),
        ("transport.plan sets it: remove that, or this", _SHARE, setup.link_share is not None),
    ]
    return next((words for words, names, applies in driven if applies and feature.name in names), None)


ROUNDING = 0.01
"""Cameras round numbers without declaring an increment; more than a hundredth of one is not rounding."""
_TAKEN = {
    "float": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "string": "text, in quotes",
    "command": f"only `{EXECUTE}`, being a command",
}


def apply_features(nodes: NodeMap, setup: CameraSetup) -> None:
    """Set the features of a setup.

    Raises ConfigurationError naming each feature that the daemon drives itself, or that the camera does not take, and
    why; NodeError when the camera refuses some for a reason that its description does not give.
    """
    features = setup.features
    if not features:
        return
    driven = any(feature.name in GAINS for feature in features) and gain_driven(nodes)
    errors = [*refuse_driven(setup, driven)] or set_features(nodes, features)
    if errors:
        kind = NodeError if all(isinstance(error, NodeError) for error in errors) else ConfigurationError
        raise kind(f"camera {nodes.serial}: features: {'; '.join(map(str, errors))}")
    done = ", ".join(f"{feature.key} {_written(feature.value)}" for feature in features)
    log.info("camera %s: features set: %s", nodes.serial, done)


def set_features(nodes: NodeMap, features: Sequence[FeatureSetting]) -> list[AutoexposeError]:
    """Set features in their order, and return what is wrong with those that the camera does not take.

    Those between two selectors or commands must all hold in the end: as long as that helps, those that the camera
    refused (locked, or out of bounds before the others were set) or changed (as binning does with the region) are set
    again. So a region may move and grow, whatever it was before.
    """
    return [error for run in _runs(nodes, features) for error in _set_run(nodes, run)]


def _set_run(nodes: NodeMap, run: Sequence[FeatureSetting]) -> list[AutoexposeError]:
    wanted = {feature.key: feature for feature in run}  # of two, the last one counts
    pending, fewest = run, len(run) + 1
    while True:
        wrong: dict[str, AutoexposeError | None] = {}
        for feature in pending:
            wrong[feature.key] = _refusal(nodes, feature)
        for key, feature in wanted.items():
            wrong[key] = wrong.get(key) or _change(nodes, feature)
        errors = {key: error for key, error in wrong.items() if error is not None}
        if not errors or len(errors) >= fewest:
            return list(errors.values())
        pending, fewest = [wanted[key] for key in errors], len(errors)


@contextlib.contextmanager
def selecting(nodes: NodeMap, selectors: Sequence[tuple[str, str]]) -> Iterator[None]:
    """Within the block these selectors are set to these entries, and afterwards back to what they were.

    Raises ConfigurationError for a name that is no selector or lacks the entry, and NodeError when the camera refuses.
    """
    with contextlib.ExitStack() as restored:
        for selector, entry in selectors:
            counts = nodes.kind(selector) == "integer" and entry.isdecimal()
            try:
                wanted = _fitting(nodes, selector, int(entry) if counts else entry)
            except ConfigurationError as error:
                raise ConfigurationError(f"its selector {selector}: {error}") from None
            present = read_feature(nodes, selector)
            if wanted != present:
                if not nodes.writable(selector):
                    raise ConfigurationError(f"its selector {selector}: it is read-only and stands at {present}")
                nodes.write(selector, wanted)
                restored.callback(nodes.write, selector, present)
        yield


def same(wanted: FeatureValue, present: FeatureValue) -> bool:
    """Whether a feature has the value that was written for it, up to the rounding of cameras."""
    if isinstance(wanted, bool) and isinstance(present, str):
        return present in SWITCHED[wanted]
    if isinstance(present, float) and not isinstance(wanted, bool | str):
        return math.isclose(wanted, present, rel_tol=ROUNDING, abs_tol=1e-9)
    return wanted == present


def _runs(nodes: NodeMap, features: Sequence[FeatureSetting]) -> Iterator[list[FeatureSetting]]:
    """The features up to a selector or command, which stands alone, and so on."""
    run: list[FeatureSetting] = []
    for feature in features:
        if nodes.kind(feature.name) == "command" or nodes.selected(feature.name):
            yield run
            yield [feature]
            run = []
        else:
            run.append(feature)
    yield run


def _refusal(nodes: NodeMap, feature: FeatureSetting) -> AutoexposeError | None:
    """Set a feature; why the camera does not take it, or None."""
    name = feature.name
    try:
        with selecting(nodes, feature.selectors):
            value = _fitting(nodes, name, feature.value)
            try:
                if nodes.kind(name) == "command":
                    nodes.execute(name)
                else:
                    hold(nodes, name, value)
            except NodeError:
                if (reason := _reason(nodes, name, value)) is not None:
                    raise ConfigurationError(reason) from None
                raise
    except ConfigurationError as error:
        return ConfigurationError(f"{feature.key}: {error}")
    except NodeError as error:
        return NodeError(f"{feature.key}: {error}")
    return None


def _change(nodes: NodeMap, feature: FeatureSetting) -> AutoexposeError | None:
    """How a feature that was set differs from what the camera now reads back; None if it holds."""
    name = feature.name
    if nodes.kind(name) == "command":
        return None
    try:
        with selecting(nodes, feature.selectors):
            present = read_feature(nodes, name)
            if same(feature.value, present):
                return None
            bounds = _bounds(nodes, name)
    except NodeError as error:
        return NodeError(f"{feature.key}: {error}")
    why = "another feature changes it" if bounds is None else f"it takes {bounds}, or another feature changes it"
    return ConfigurationError(
        f"{feature.key}: set to {_written(feature.value)}, it reads back {_written(present)}: {why}"
    )


def _fitting(nodes: NodeMap, name: str, value: FeatureValue) -> FeatureValue:
    """The value as this feature takes it, apart from its bounds; raises ConfigurationError for one of another kind."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    match nodes.kind(name):
        case "float" if number:
            return float(value)
        case "integer" if number and isinstance(value, int):
            return value
        case "boolean" if isinstance(value, bool):
            return value
        case "string" if isinstance(value, str):
            return value
        case "command" if value == EXECUTE:
            return value
        case "enumeration":
            return _entry(nodes.entries(name), value)
        case None if nodes.exists(name):
            raise ConfigurationError("it holds no value that can be set")
        case None:
            raise ConfigurationError(f"the camera has no such feature{_hint(name, nodes.features())}")
        case kind:
            raise ConfigurationError(f"it takes {_TAKEN[kind]}, not {value!r}")


def _entry(entries: Sequence[str], value: FeatureValue) -> str:
    """The entry that a value names; YAML reads Off and On without quotes as booleans."""
    names = SWITCHED[value] if isinstance(value, bool) else (str(value),)
    for entry in names:
        if entry in entries:
            return entry
    if not entries:
        raise ConfigurationError("it is not available at present")
    raise ConfigurationError(f"it takes {', '.join(entries)}, not {_written(value)}{_hint(str(value), entries)}")


def _hint(name: str, known: Sequence[str]) -> str:
    lower = {each.lower(): each for each in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1)
    return f"; did you mean {lower[near[0]]}?" if near else ""


def _reason(nodes: NodeMap, name: str, value: FeatureValue) -> str | None:
    """Why the camera refused a value of the right kind; None if neither its access nor its bounds explain it."""
    if not nodes.available(name):
        return "it is not available at present"
    if not nodes.writable(name):
        return "it is read-only, or locked at present by another feature"
    bounds = _bounds(nodes, name)
    return None if bounds is None else f"it takes {bounds}, not {_written(value)}"


def _bounds(nodes: NodeMap, name: str) -> str | None:
    """What numbers a feature takes; None for other kinds."""
    if not is_number(nodes, name):
        return None
    (low, high), step, unit = nodes.bounds(name), nodes.increment(name), nodes.unit(name)
    steps = f" in steps of {step:.10g}" if step not in (0, 1) else ""
    return f"{low:.10g} to {high:.10g}{f' {unit}' if unit else ''}{steps} at present"


def _written(value: FeatureValue) -> str:
    """As people write it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


USER_SET, LOAD, DEFAULT = "UserSetSelector", "UserSetLoad", "Default"
PACKET_DELAY = "GevSCPD"
_ATTEMPTS = 4
"""Attempts at putting back features that depend on each other, such as binning, sizes and offsets."""


@dataclass(frozen=True, slots=True)
class Inventory:
    """Settings in the order of the description, and the features that were left out.

    `unread` could not be read, or not be written in a list. `tables` have several selectors, or one that counts, as
    look-up tables have.
    """

    settings: tuple[FeatureSetting, ...]
    unread: tuple[str, ...]
    tables: tuple[str, ...]


def read_inventory(nodes: NodeMap) -> Inventory:
    """Read every feature that can be set at present and is worth storing, for each entry of its selector."""
    names = [name for name in nodes.features() if nodes.kind(name) not in (None, "command")]
    stored = _stored(nodes, names)
    selectors = [name for name in names if name.endswith(("Selector", "Index")) and nodes.selected(name)]
    above = {name: [each for each in selectors if name in nodes.selected(each)] for name in names}
    values: dict[str, list[FeatureSetting]] = {name: [] for name in stored if name not in selectors}
    unread: dict[str, None] = {}

    def note(selectors: tuple[tuple[str, str], ...], names: Iterable[str]) -> None:
        for name in names:
            try:
                if not nodes.writable(name):
                    continue
                value = read_feature(nodes, name)
                if misfit(value) is not None:
                    unread[name] = None
                elif nodes.kind(name) != "enumeration" or value in nodes.entries(name):
                    values[name].append(FeatureSetting(name, value, selectors))
            except NodeError:
                unread[name] = None

    note((), [name for name in values if not above[name]])
    for selector in selectors:
        selected = [name for name in values if above[name] == [selector]]
        try:
            for entry in offered(nodes, selector) if selected else ():
                with selecting(nodes, ((selector, entry),)):
                    note(((selector, entry),), selected)
        except (ConfigurationError, NodeError):
            unread[selector] = None
    tables = [name for name in values if len(above[name]) > 1 or "integer" in map(nodes.kind, above[name])]
    settings = tuple(setting for found in values.values() for setting in found)
    return Inventory(settings, tuple(unread), tuple(tables))


def _stored(nodes: NodeMap, names: Sequence[str]) -> list[str]:
    """Those of the features that belong to what a camera is set to, rather than to its network.

    Many descriptions mark them as streamable, Width for one. If not even Width is, all are taken except those of GigE
    Vision's own registers, such as the camera's address; the packet delay belongs to both.
    """
    streamable = nodes.streamable()
    if "Width" in streamable:
        return [name for name in names if name in streamable]
    return [name for name in names if not name.startswith("Gev") or name == PACKET_DELAY]


def differing(nodes: NodeMap, settings: Iterable[FeatureSetting]) -> list[tuple[FeatureSetting, FeatureValue | None]]:
    """The settings that the camera does not have at present, and what it has instead; None: it cannot be read."""
    found: list[tuple[FeatureSetting, FeatureValue | None]] = []
    for setting in settings:
        present: FeatureValue | None = None
        try:
            with selecting(nodes, setting.selectors):
                present = read_feature(nodes, setting.name)
        except (ConfigurationError, NodeError):
            pass
        if present is None or not same(setting.value, present):
            found.append((setting, present))
    return found


def changed_from_default(
    nodes: NodeMap, settings: Sequence[FeatureSetting]
) -> tuple[list[FeatureSetting], list[FeatureSetting]]:
    """Those present settings that differ from the camera's default user set, and those that were not put back.

    Loads that user set, compares, and sets what differs again. Raises UnsupportedCameraError when the camera has no
    default user set.
    """
    if DEFAULT not in nodes.entries(USER_SET) or nodes.kind(LOAD) != "command":
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: it has no {USER_SET} {DEFAULT} to compare with: switch it off and on, "
            "save its settings with --save FILE, and compare later ones with --diff FILE"
        )
    with selecting(nodes, ((USER_SET, DEFAULT),)):
        nodes.execute(LOAD)
    changed = [setting for setting, _ in differing(nodes, settings)]
    lost = changed
    for _ in range(_ATTEMPTS):
        set_features(nodes, lost)
        lost = [setting for setting, _ in differing(nodes, settings)]
        if not lost:
            break
    return changed, lost
