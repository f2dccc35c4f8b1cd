"""The daemon's configuration: its sections and keys, checked before anything is opened."""

from __future__ import annotations

from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, field_validator, model_validator

from autoexpose_daemon.config.control import ControlConfig, ExposureConfig, StartConfig
from autoexpose_daemon.config.section import (
    Binning,
    ConnectionConfig,
    ExposureCountUs,
    FileName,
    LimitsConfig,
    LinkMbps,
    Name,
    OffsetStops,
    PacketBytes,
    PhaseMs,
    PolicyId,
    RateHz,
    SampleAgeS,
    Section,
    UtcOffsetS,
    said_of,
)
from autoexpose_daemon.messages.frames import Stamping
from autoexpose_daemon.messages.keys import (
    LAST_ROS2_DOMAIN,
    LOOPBACK,
    ONE_GROUP,
    ROUTER,
    check_key_expression,
    check_rig_name,
)
from calibration.gain import GainFile
from calibration.geometry.file import check_camera, check_pair, load_geometry
from calibration.geometry.numbers import baseline_note
from calibration.response.file import ResponseFile
from calibration.vignetting.file import VignettingFile
from documents.bounds import CAMERA_NAME
from documents.text import quoted
from drivers.camera import CameraDescription
from drivers.genicam.trigger import ACTION, SOFTWARE
from drivers.setup import FeatureSetting, as_list, parse_features
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName
from imaging.gain_scale import GainScale
from imaging.geometry import CameraGeometry, Side
from imaging.pixels import PixelFormat
from imaging.python310 import Self
from imaging.response import ResponseFunction


def _refuse_number(serial: object) -> object:
    if isinstance(serial, int | float):  # as a number it may have lost leading zeros already
        raise ValueError("is a number to YAML: put the serial in quotes, as `autoexpose list` shows it")
    return serial


def _group_name(name: str) -> str:
    if not CAMERA_NAME.fullmatch(name):
        raise ValueError(f"{quoted(name)} is no name: begin with a small letter, then small letters, digits and _")
    return name


Features = Annotated[tuple[FeatureSetting, ...], BeforeValidator(parse_features), PlainSerializer(as_list)]


class CameraConfig(Section):
    """One camera: its serial, its calibration files (without a response file it is linear), and features to set.

    Cameras of one `group` are exposed together.
    `exposure_count_us` are the microseconds in a count of an exposure time whose unit the camera does not give.
    With `transport.plan` cameras that name the same `link`, or none, share one.
    `offset_stops` is by how much less light reaches its sensor than those of the other cameras.
    """

    serial: Annotated[Name, BeforeValidator(_refuse_number)]
    group: Annotated[str, AfterValidator(_group_name)] = ONE_GROUP
    response: FileName | None = None
    gain_calibration: FileName | None = None
    calibration: FileName | None = None
    vignetting: FileName | None = None
    exposure_count_us: ExposureCountUs | None = None
    link: Name | None = None
    offset_stops: OffsetStops = 0.0
    features: Features = ()

    def relative_to(self, folder: Path) -> Self:
        """The same with the paths of its files relative to `folder`."""
        files = {key: getattr(self, key) for key in ("response", "gain_calibration", "calibration", "vignetting")}
        return self.model_copy(update={key: path and folder / path for key, path in files.items()})


MOST_CAMERAS = 8


def _named(cameras: dict[CameraName, CameraConfig]) -> dict[CameraName, CameraConfig]:
    """The cameras of a rig, if their names and serials are such; of a stereo pair, left comes first."""
    if not 1 <= len(cameras) <= MOST_CAMERAS:
        raise ValueError(f"names {len(cameras) or 'no'} cameras: give 1 to {MOST_CAMERAS}, each with its serial")
    for name in cameras:
        if not CAMERA_NAME.fullmatch(name):
            raise ValueError(
                f"{quoted(name)} is no name for a camera: begin with a small letter, then up to 63 small letters, "
                "digits and _; consumers, both and several are taken"
            )
    for (name, camera), (other_name, other) in combinations(cameras.items(), 2):
        if camera.serial == other.serial:
            raise ValueError(f"{name} and {other_name} are the same camera, {camera.serial}")
        if camera.serial.casefold() == other.serial.casefold():
            raise ValueError(
                f"{name} and {other_name} differ only in case, {camera.serial} and {other.serial}: give each serial "
                "as `autoexpose list` shows it"
            )
    return dict(sorted(cameras.items(), key=lambda entry: entry[0] == "right"))


Cameras = Annotated[dict[CameraName, CameraConfig], AfterValidator(_named)]


class ImuConfig(ConnectionConfig):
    """An IMU on zenoh: `sensor_msgs/msg/Imu` under a key, and how old a sample may be when a step is decided."""

    key: Annotated[str, AfterValidator(check_key_expression)]
    max_age_s: SampleAgeS = 0.1
    connect: tuple[str, ...] = (ROUTER,)


class MotionConfig(Section):
    """Where the speed of the image comes from; without an IMU it is optical flow."""

    imu: ImuConfig | None = None


class PublishConfig(ConnectionConfig):
    """How other processes get the frames; without this section they get none.

    With `stamp` ptp messages are stamped with the middle of the exposure in PTP time less `ptp_utc_offset_s`: 37 if the
    master gives TAI, 0 if it gives UTC.
    """

    rig: str = "rig"
    listen: tuple[str, ...] = (LOOPBACK,)
    stamp: Literal["start", "middle", "end", "ptp"] = "middle"
    ptp_utc_offset_s: UtcOffsetS = 37
    ros2_domain: Annotated[int, Field(ge=0, le=LAST_ROS2_DOMAIN, strict=True)] | None = None

    @field_validator("rig")
    @classmethod
    def _rig_is_a_name(cls, rig: str) -> str:
        check_rig_name(rig)
        return rig

    @model_validator(mode="after")
    def _an_offset_is_for_ptp(self) -> Self:
        if self.stamp != "ptp" and "ptp_utc_offset_s" in self.model_fields_set:
            raise ValueError(f"ptp_utc_offset_s has no effect with stamp {self.stamp}: remove it, or set stamp: ptp")
        return self

    @property
    def stamping(self) -> Stamping:
        """How messages are stamped."""
        return Stamping("middle", self.ptp_utc_offset_s) if self.stamp == "ptp" else Stamping(self.stamp)


DEFAULT_START = ExposureSetting(2000.0, 0.0)
"""Right for an office, and six stops from either end of the range."""


class TriggerConfig(Section):
    """What starts a frame: pulses on an input line, the left camera for both, a camera's own clock, or the daemon."""

    mode: Literal["external", "primary", "free_run", "software", "ptp"] = "external"
    line: Name = "Line0"
    output_line: Name = "Line1"
    rate_hz: RateHz = 60.0
    phase_ms: PhaseMs | None = None

    @property
    def by_host(self) -> bool:
        """Whether the daemon itself triggers the cameras."""
        return self.mode in ("software", "ptp")

    @model_validator(mode="after")
    def _lines_are_used(self) -> Self:
        if self.by_host:
            for key in ("line", "output_line"):
                if key in self.model_fields_set:
                    raise ValueError(f"{key} has no effect with mode {self.mode}, which needs no wire: remove it")
        return self

    @model_validator(mode="after")
    def _the_phase_is_one(self) -> Self:
        if self.phase_ms is None:
            return self
        if not self.by_host:
            raise ValueError(
                f"phase_ms has no effect with mode {self.mode}, whose triggers the daemon does not give: remove it, or "
                "choose mode ptp or software"
            )
        if not self.rate_hz.is_integer():
            raise ValueError(
                f"phase_ms needs a whole number of triggers a second: at rate_hz {self.rate_hz:g} they are at other "
                "times in each second"
            )
        if self.phase_ms >= 1e3 / self.rate_hz:
            raise ValueError(
                f"phase_ms {self.phase_ms:g} does not fit into the {1e3 / self.rate_hz:.4g} ms between triggers at "
                f"rate_hz {self.rate_hz:g}: give less, from 0"
            )
        return self


class ResponseConfig(Section):
    """What the daemon does about response functions that no longer hold.

    `refine` keeps an updated copy beside each response file; the file itself is never written.
    """

    refine: bool = False


class TransportConfig(Section):
    """GigE Vision tuning; the defaults suit a direct link.

    With `packet_size_bytes` None, camera and host agree on the largest that passes. With `plan`, cameras that share
    a link send no faster than it takes; its speed is that of the host's interface unless `link_mbps` says otherwise.
    """

    packet_size_bytes: PacketBytes | None = None
    plan: bool = False
    link_mbps: LinkMbps | None = None

    @model_validator(mode="after")
    def _a_speed_is_for_a_plan(self) -> Self:
        if self.link_mbps is not None and not self.plan:
            raise ValueError("link_mbps has no effect without plan: set transport.plan: true, or remove it")
        return self


class ImageConfig(Section):
    """What the cameras send; None leaves a camera as it is."""

    pixel_format: PixelFormat | None = None
    binning: Binning | None = None


class GroupConfig(Section):
    """What the cameras of one group have instead of what is common."""

    policy: PolicyId | None = None
    exposure: LimitsConfig | None = None
    start: StartConfig | None = None


class Config(Section):
    """The whole configuration."""

    cameras: Cameras
    trigger: TriggerConfig = TriggerConfig()
    exposure: ExposureConfig = ExposureConfig()
    control: ControlConfig = ControlConfig()
    response: ResponseConfig = ResponseConfig()
    transport: TransportConfig = TransportConfig()
    image: ImageConfig = ImageConfig()
    motion: MotionConfig = MotionConfig()
    publish: PublishConfig | None = None
    groups: dict[str, GroupConfig] = {}
    pairs: dict[Name, tuple[CameraName, CameraName]] = {}

    @model_validator(mode="after")
    def _sections_fit_each_other(self) -> Self:
        if self.trigger.mode == "free_run" and len(self.cameras) > 1:
            raise ValueError("trigger.mode free_run is for one camera: two that run freely never see the same instant")
        if self.trigger.mode == "primary" and len(self.cameras) == 1:
            raise ValueError("trigger.mode primary needs two cameras: for a single one choose free_run")
        if self.publish is not None and self.publish.stamp == "ptp" and self.trigger.mode != "ptp":
            raise ValueError(
                f"publish.stamp ptp needs cameras whose clocks follow PTP, which with trigger.mode {self.trigger.mode} "
                "they do not: set trigger.mode: ptp, or publish.stamp: middle"
            )
        for name in self.control.roi.keys() - self.cameras.keys():
            raise ValueError(f"control.roi.{name} is given, but cameras.{name} is not: remove it")
        if self.response.refine and all(camera.response is None for camera in self.cameras.values()):
            raise ValueError(
                f"response.refine needs a response file to refine: give cameras.{self.primary}.response, or remove it"
            )
        imu, focal_length_px = self.motion.imu, self.control.focal_length_px
        if imu is not None and focal_length_px is None:
            raise ValueError(f"motion.imu needs control.focal_length_px: give that of cameras.{self.primary} in pixels")
        if focal_length_px is not None and imu is None:
            raise ValueError("control.focal_length_px has no effect without motion.imu: give motion.imu, or remove it")
        for name in self.groups.keys() - self.cameras_of_groups.keys():
            raise ValueError(f"groups.{name} has no camera: give one `group: {name}`, or remove it")
        for name in self.groups:
            self.of_group(name)
        for pair, (left, right) in self.pairs.items():
            if left == right:
                raise ValueError(f"pairs.{pair} has {left} twice: give its left and its right camera")
            for name in {left, right} - self.cameras.keys():
                raise ValueError(f"pairs.{pair} names {quoted(name)}, which is not among cameras")
        self._check_exposure()
        return self

    def _check_exposure(self) -> None:
        period_us = 1e6 / self.trigger.rate_hz
        if self.exposure.max_time_us >= period_us:
            raise ConfigurationError(
                f"exposure.max_time_us {self.exposure.max_time_us:g} us does not fit into the "
                f"{period_us:.0f} us between triggers at trigger.rate_hz {self.trigger.rate_hz:g}"
            )
        if not self.exposure.limits().contain(self.start):
            raise ConfigurationError(f"control.start {self.start} is outside the bounds of exposure")

    @property
    def cameras_of_groups(self) -> dict[str, tuple[CameraName, ...]]:
        """The cameras of each group, as they come in the configuration."""
        found: dict[str, tuple[CameraName, ...]] = {}
        for name, camera in self.cameras.items():
            found[camera.group] = (*found.get(camera.group, ()), name)
        return found

    def of_group(self, group: str) -> Config:
        """The configuration as if the rig had only the cameras of a group: itself, if there is one group alone.

        Raises ConfigurationError if what the group has of its own does not fit the rest.
        """
        own = self.groups.get(group, GroupConfig())
        if len(self.cameras_of_groups) == 1 and own == GroupConfig():
            return self
        cameras = {name: self.cameras[name] for name in self.cameras_of_groups[group]}
        changed = {name: value for name in ("policy", "start") if (value := getattr(own, name)) is not None}
        roi = {name: region for name, region in self.control.roi.items() if name in cameras}
        bounds = {} if own.exposure is None else own.exposure.model_dump(exclude_none=True)
        part = self.model_copy(
            update={
                "cameras": cameras,
                "control": self.control.model_copy(update=changed | {"roi": roi}),
                "exposure": self.exposure.model_copy(update=bounds),
                "groups": {},
            }
        )
        with said_of(f"groups.{group}"):
            part._check_exposure()
        return part

    @property
    def primary(self) -> CameraName:
        """The first camera, which decisions refer to; in `trigger.mode` primary it triggers the others."""
        return next(iter(self.cameras))

    @property
    def stereo_pairs(self) -> dict[str, tuple[CameraName, CameraName]]:
        """The left and the right camera of each stereo pair; those named `left` and `right` are one without `pairs`."""
        given = {"stereo": ("left", "right")} if {"left", "right"} <= self.cameras.keys() else {}
        return given | self.pairs

    def side_of(self, camera: CameraName) -> Side:
        """Which camera of its stereo pair it is; a camera of none is a left one."""
        return "right" if camera in {right for _, right in self.stereo_pairs.values()} else "left"

    @property
    def trigger_sources(self) -> dict[CameraName, str]:
        """The TriggerSource of each camera that waits for triggers."""
        match self.trigger.mode:
            case "external":
                return dict.fromkeys(self.cameras, self.trigger.line)
            case "primary":
                return {name: self.trigger.line for name in self.cameras if name != self.primary}
            case "software":
                return dict.fromkeys(self.cameras, SOFTWARE)
            case "ptp":
                return dict.fromkeys(self.cameras, ACTION)
            case "free_run":
                return {}

    @property
    def start(self) -> ExposureSetting:
        """The exposure before the first frame: 2 ms without gain unless configured, within the bounds."""
        configured = self.control.start
        if configured is not None:
            return ExposureSetting(configured.exposure_time_us, configured.gain_db)
        return self.exposure.limits().realise(DEFAULT_START.level, DEFAULT_START.exposure_time_us)

    @cached_property
    def responses(self) -> dict[CameraName, ResponseFile]:
        """The response file of each camera, read once: linear if none is configured.

        Raises ConfigurationError naming key and file if a file cannot be used, or is for another camera or image
        format.
        """
        files: dict[CameraName, ResponseFile] = {}
        for name, camera in self.cameras.items():
            with said_of(f"cameras.{name}.response"):
                path = camera.response
                file = ResponseFile(ResponseFunction.linear()) if path is None else ResponseFile.load(path)
                file.check_belongs(camera.serial, self.image.pixel_format, self.image.binning)
            files[name] = file
        return files

    @cached_property
    def gain_scales(self) -> dict[CameraName, GainScale | None]:
        """The scale of each camera's gain, read once; None if none is configured.

        Raises ConfigurationError naming key and file if a file cannot be used, or is for another camera.
        """
        scales: dict[CameraName, GainScale | None] = dict.fromkeys(self.cameras)
        for name, camera in self.cameras.items():
            if camera.gain_calibration is None:
                continue
            with said_of(f"cameras.{name}.gain_calibration"):
                file = GainFile.load(camera.gain_calibration)
                file.check_belongs(camera.serial)
            scales[name] = file.scale
        return scales

    @cached_property
    def calibrations(self) -> dict[CameraName, CameraGeometry]:
        """The geometry of each camera that has a calibration file, read once.

        Raises ConfigurationError naming key and file if a file cannot be used, is for another camera, or does not fit
        the other camera's.
        """
        geometries: dict[CameraName, CameraGeometry] = {}
        for name, camera in self.cameras.items():
            if camera.calibration is not None:
                with said_of(f"cameras.{name}.calibration"):
                    geometries[name] = load_geometry(camera.calibration, self.side_of(name))
                with said_of(f"cameras.{name}.calibration: {camera.calibration}"):
                    check_camera(geometries[name], camera.serial)
        for left, right in self.stereo_pairs.values():
            check_pair(geometries.get(left), geometries.get(right), left, right)
        return geometries

    @property
    def notes(self) -> tuple[str, ...]:
        """What the files it names say that few rigs have, one line each."""
        notes = {right: baseline_note(self.calibrations.get(right)) for _, right in self.stereo_pairs.values()}
        return tuple(f"cameras.{name}.calibration: {note}" for name, note in notes.items() if note is not None)

    @cached_property
    def vignettings(self) -> dict[CameraName, VignettingFile]:
        """The vignetting file of each camera that has one, read once.

        Raises ConfigurationError naming key and file if a file cannot be used, or is for another camera.
        """
        files: dict[CameraName, VignettingFile] = {}
        for name, camera in self.cameras.items():
            if camera.vignetting is not None:
                with said_of(f"cameras.{name}.vignetting"):
                    files[name] = VignettingFile.load(camera.vignetting)
                    files[name].check_belongs(camera.serial)
        return files

    def check_frames(self, name: CameraName, description: CameraDescription) -> None:
        """Refuse files that were made for a different pixel format or size than a camera sends.

        Raises ConfigurationError naming key and file.
        """
        camera = self.cameras[name]
        self.responses[name].check_belongs(camera.serial, description.pixel_format)
        if name in self.calibrations:
            with said_of(f"cameras.{name}.calibration: {camera.calibration}"):
                check_camera(self.calibrations[name], camera.serial, description.size)
        if name in self.vignettings:
            with said_of(f"cameras.{name}.vignetting"):
                self.vignettings[name].check_belongs(camera.serial, description.size)
