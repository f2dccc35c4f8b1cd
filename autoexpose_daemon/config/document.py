"""The daemon's configuration: its sections and keys, checked before anything is opened."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, field_validator, model_validator

from autoexpose_daemon.config.control import ControlConfig, ExposureConfig
from autoexpose_daemon.config.section import (
    Binning,
    ConnectionConfig,
    ExposureCountUs,
    FileName,
    LinkMbps,
    Name,
    PacketBytes,
    RateHz,
    SampleAgeS,
    Section,
    said_of,
)
from autoexpose_daemon.messages.frames import Stamp
from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN, LOOPBACK, ROUTER, check_key_expression, check_rig_name
from calibration.gain import GainFile
from calibration.geometry.file import check_camera, check_pair, load_geometry
from calibration.geometry.numbers import baseline_note
from calibration.response.file import ResponseFile
from calibration.vignetting.file import VignettingFile
from drivers.camera import CameraDescription
from drivers.genicam.trigger import ACTION, SOFTWARE
from drivers.setup import FeatureSetting, as_list, parse_features
from imaging.exposure import ExposureSetting
from imaging.frames import Side
from imaging.gain_scale import GainScale
from imaging.geometry import CameraGeometry
from imaging.pixels import PixelFormat
from imaging.python310 import Self
from imaging.response import ResponseFunction


def _refuse_number(serial: object) -> object:
    if isinstance(serial, int | float):  # as a number it may have lost leading zeros already
        raise ValueError("is a number to YAML: put the serial in quotes, as `autoexpose list` shows it")
    return serial


Features = Annotated[tuple[FeatureSetting, ...], BeforeValidator(parse_features), PlainSerializer(as_list)]


class CameraConfig(Section):
    """One camera: its serial, its calibration files (without a response file it is linear), and features to set.

    `exposure_count_us` are the microseconds in a count of an exposure time whose unit the camera does not give.
    """

    serial: Annotated[Name, BeforeValidator(_refuse_number)]
    response: FileName | None = None
    gain_calibration: FileName | None = None
    calibration: FileName | None = None
    vignetting: FileName | None = None
    exposure_count_us: ExposureCountUs | None = None
    features: Features = ()

    def relative_to(self, folder: Path) -> Self:
        """The same with the paths of its files relative to `folder`."""
        files = {key: getattr(self, key) for key in ("response", "gain_calibration", "calibration", "vignetting")}
        return self.model_copy(update={key: path and folder / path for key, path in files.items()})


class CamerasConfig(Section):
    """The cameras of the rig; a rig with one camera has only `left`."""

    left: CameraConfig
    right: CameraConfig | None = None

    @model_validator(mode="after")
    def _two_cameras_are_two(self) -> Self:
        if self.right is None or self.right.serial.casefold() != self.left.serial.casefold():
            return self
        if self.right.serial == self.left.serial:
            raise ValueError(f"left and right are the same camera, {self.left.serial}")
        raise ValueError(
            f"left and right differ only in case, {self.left.serial} and {self.right.serial}: give each serial "
            "as `autoexpose list` shows it"
        )


class ImuConfig(ConnectionConfig):
    """An IMU on zenoh: `sensor_msgs/msg/Imu` under a key, and how old a sample may be when a step is decided."""

    key: Annotated[str, AfterValidator(check_key_expression)]
    max_age_s: SampleAgeS = 0.1
    connect: tuple[str, ...] = (ROUTER,)


class MotionConfig(Section):
    """Where the speed of the image comes from; without an IMU it is optical flow."""

    imu: ImuConfig | None = None


class PublishConfig(ConnectionConfig):
    """How other processes get the frames; without this section they get none."""

    rig: str = "rig"
    listen: tuple[str, ...] = (LOOPBACK,)
    stamp: Stamp = "middle"
    ros2_domain: Annotated[int, Field(ge=0, le=LAST_ROS2_DOMAIN, strict=True)] | None = None

    @field_validator("rig")
    @classmethod
    def _rig_is_a_name(cls, rig: str) -> str:
        check_rig_name(rig)
        return rig


DEFAULT_START = ExposureSetting(2000.0, 0.0)
"""Right for an office, and six stops from either end of the range."""


class TriggerConfig(Section):
    """What starts a frame: pulses on an input line, the left camera for both, a camera's own clock, or the daemon."""

    mode: Literal["external", "primary", "free_run", "software", "ptp"] = "external"
    line: Name = "Line0"
    output_line: Name = "Line1"
    rate_hz: RateHz = 60.0

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


class Config(Section):
    """The whole configuration."""

    cameras: CamerasConfig
    trigger: TriggerConfig = TriggerConfig()
    exposure: ExposureConfig = ExposureConfig()
    control: ControlConfig = ControlConfig()
    response: ResponseConfig = ResponseConfig()
    transport: TransportConfig = TransportConfig()
    image: ImageConfig = ImageConfig()
    motion: MotionConfig = MotionConfig()
    publish: PublishConfig | None = None

    @model_validator(mode="after")
    def _sections_fit_each_other(self) -> Self:
        if self.trigger.mode == "free_run" and self.cameras.right is not None:
            raise ValueError("trigger.mode free_run is for one camera: two that run freely never see the same instant")
        if self.trigger.mode == "primary" and self.cameras.right is None:
            raise ValueError("trigger.mode primary needs two cameras: for a single one choose free_run")
        if self.control.roi.right is not None and self.cameras.right is None:
            raise ValueError("control.roi.right is given, but cameras.right is not: remove it")
        if self.response.refine and all(camera.response is None for camera in self.sides.values()):
            raise ValueError(
                "response.refine needs a response file to refine: give cameras.left.response, or remove it"
            )
        imu, focal_length_px = self.motion.imu, self.control.focal_length_px
        if imu is not None and focal_length_px is None:
            raise ValueError("motion.imu needs control.focal_length_px: give the left camera's focal length in pixels")
        if focal_length_px is not None and imu is None:
            raise ValueError("control.focal_length_px has no effect without motion.imu: give motion.imu, or remove it")
        period_us = 1e6 / self.trigger.rate_hz
        if self.exposure.max_time_us >= period_us:
            raise ValueError(
                f"exposure.max_time_us {self.exposure.max_time_us:g} us does not fit into the "
                f"{period_us:.0f} us between triggers at trigger.rate_hz {self.trigger.rate_hz:g}"
            )
        if not self.exposure.limits().contain(self.start):
            raise ValueError(f"control.start {self.start} is outside the bounds of exposure")
        return self

    @property
    def sides(self) -> dict[Side, CameraConfig]:
        """The configured cameras, left first."""
        cameras: dict[Side, CameraConfig] = {"left": self.cameras.left}
        if self.cameras.right is not None:
            cameras["right"] = self.cameras.right
        return cameras

    @property
    def trigger_sources(self) -> dict[Side, str]:
        """The TriggerSource of each camera that waits for triggers."""
        match self.trigger.mode:
            case "external":
                return dict.fromkeys(self.sides, self.trigger.line)
            case "primary":
                return {"right": self.trigger.line}
            case "software":
                return dict.fromkeys(self.sides, SOFTWARE)
            case "ptp":
                return dict.fromkeys(self.sides, ACTION)
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
    def responses(self) -> dict[Side, ResponseFile]:
        """The response file of each camera, read once: linear if none is configured.

        Raises ConfigurationError naming key and file if a file cannot be used, or is for another camera or image
        format.
        """
        files: dict[Side, ResponseFile] = {}
        for side, camera in self.sides.items():
            with said_of(f"cameras.{side}.response"):
                path = camera.response
                file = ResponseFile(ResponseFunction.linear()) if path is None else ResponseFile.load(path)
                file.check_belongs(camera.serial, self.image.pixel_format, self.image.binning)
            files[side] = file
        return files

    @cached_property
    def gain_scales(self) -> dict[Side, GainScale | None]:
        """The scale of each camera's gain, read once; None if none is configured.

        Raises ConfigurationError naming key and file if a file cannot be used, or is for another camera.
        """
        scales: dict[Side, GainScale | None] = dict.fromkeys(self.sides)
        for side, camera in self.sides.items():
            if camera.gain_calibration is None:
                continue
            with said_of(f"cameras.{side}.gain_calibration"):
                file = GainFile.load(camera.gain_calibration)
                file.check_belongs(camera.serial)
            scales[side] = file.scale
        return scales

    @cached_property
    def calibrations(self) -> dict[Side, CameraGeometry]:
        """The geometry of each camera that has a calibration file, read once.

        Raises ConfigurationError naming key and file if a file cannot be used, is for another camera, or does not fit
        the other camera's.
        """
        geometries: dict[Side, CameraGeometry] = {}
        for side, camera in self.sides.items():
            if camera.calibration is not None:
                with said_of(f"cameras.{side}.calibration"):
                    geometries[side] = load_geometry(camera.calibration, side)
                with said_of(f"cameras.{side}.calibration: {camera.calibration}"):
                    check_camera(geometries[side], camera.serial)
        check_pair(geometries)
        return geometries

    @property
    def notes(self) -> tuple[str, ...]:
        """What the files it names say that few rigs have, one line each."""
        note = baseline_note(self.calibrations.get("right"))
        return () if note is None else (f"cameras.right.calibration: {note}",)

    @cached_property
    def vignettings(self) -> dict[Side, VignettingFile]:
        """The vignetting file of each camera that has one, read once.

        Raises ConfigurationError naming key and file if a file cannot be used, or is for another camera.
        """
        files: dict[Side, VignettingFile] = {}
        for side, camera in self.sides.items():
            if camera.vignetting is not None:
                with said_of(f"cameras.{side}.vignetting"):
                    files[side] = VignettingFile.load(camera.vignetting)
                    files[side].check_belongs(camera.serial)
        return files

    def check_frames(self, side: Side, description: CameraDescription) -> None:
        """Refuse files that were made for a different pixel format or size than a camera sends.

        Raises ConfigurationError naming key and file.
        """
        camera = self.sides[side]
        self.responses[side].check_belongs(camera.serial, description.pixel_format)
        if side in self.calibrations:
            with said_of(f"cameras.{side}.calibration: {camera.calibration}"):
                check_camera(self.calibrations[side], camera.serial, description.size)
        if side in self.vignettings:
            with said_of(f"cameras.{side}.vignetting"):
                self.vignettings[side].check_belongs(camera.serial, description.size)
