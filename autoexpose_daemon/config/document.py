"""The daemon's configuration: its sections and keys, checked before anything is opened."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, PlainSerializer, model_validator

from autoexpose_daemon.config.motion import MotionConfig
from autoexpose_daemon.config.publish import PublishConfig
from autoexpose_daemon.config.roi import RoiConfig
from autoexpose_daemon.config.said_of import said_of
from autoexpose_daemon.config.section import (
    BalanceOffset,
    BalanceWeight,
    Binning,
    BracketExposures,
    BracketStops,
    ExposureTimeUs,
    FlickerHz,
    FocalLengthPx,
    FullWellE,
    GainDb,
    LinkMbps,
    MeanTarget,
    MetricDelta,
    MetricLambda,
    Name,
    PacketBytes,
    RateHz,
    ReadNoiseE,
    Section,
)
from autoexpose_daemon.control.parameters import BalanceId, Bracketing, ControlParameters, MotionId
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, check_policy_id
from calibration.gain.file import GainFile
from calibration.geometry.file import check_camera, check_pair, load_geometry
from calibration.geometry.model import CameraGeometry
from calibration.response import ResponseFunction
from calibration.response.file import ResponseFile
from calibration.vignetting.file import VignettingFile
from drivers.camera import CameraDescription
from drivers.config.feature import FeatureSetting, as_list, parse_features
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.exposure.gain_scale import GainScale
from drivers.frames import Side
from drivers.genicam.trigger import ACTION, SOFTWARE
from drivers.pixels.formats import PixelFormat
from drivers.python310 import Self

DEFAULT_START = ExposureSetting(2000.0, 0.0)
"""Right for an office, and six stops from either end of the range."""


def _refuse_number(serial: object) -> object:
    if isinstance(serial, int | float):  # as a number it may have lost leading zeros already
        raise ValueError(f'{serial} is a number: put the serial in quotes, "{serial}"')
    return serial


Features = Annotated[tuple[FeatureSetting, ...], BeforeValidator(parse_features), PlainSerializer(as_list)]


class CameraConfig(Section):
    """One camera: its serial, its calibration files (without a response file it is linear), and features to set."""

    serial: Annotated[Name, BeforeValidator(_refuse_number)]
    response: Path | None = None
    gain_calibration: Path | None = None
    calibration: Path | None = None
    vignetting: Path | None = None
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


class ExposureConfig(Section):
    """Bounds of the exposure; each is clipped to the camera's own."""

    min_time_us: ExposureTimeUs = 20.0
    max_time_us: ExposureTimeUs = 7500.0
    min_gain_db: GainDb = 0.0
    max_gain_db: GainDb = 30.0

    @model_validator(mode="after")
    def _leaves_a_choice(self) -> Self:
        self.limits()
        return self

    def limits(self) -> ExposureLimits:
        """The bounds as limits."""
        return ExposureLimits(self.min_time_us, self.max_time_us, self.min_gain_db, self.max_gain_db)


class StartConfig(Section):
    """The exposure before the first frame; the policy `fixed` stays there."""

    exposure_time_us: ExposureTimeUs
    gain_db: GainDb = 0.0


_TUNING = ControlParameters()
_BRACKETING = Bracketing()


class BracketConfig(Section):
    """Brackets, recorded to judge policies later, instead of exposures by the policy."""

    exposures: BracketExposures = _BRACKETING.exposures
    range_stops: BracketStops = _BRACKETING.range_stops
    keep: bool = _BRACKETING.keep

    def bracketing(self) -> Bracketing:
        """The same for control."""
        return Bracketing(self.exposures, self.range_stops, self.keep)


class ControlConfig(Section):
    """Which policy decides, where it starts, what it looks at, and how it is tuned."""

    policy: str = DEFAULT_POLICY
    start: StartConfig | None = None
    roi: RoiConfig = RoiConfig()
    balance: BalanceId = _TUNING.balance
    flicker_hz: FlickerHz = "auto" if _TUNING.flicker_hz is None else _TUNING.flicker_hz
    motion: MotionId = _TUNING.motion
    focal_length_px: FocalLengthPx | None = _TUNING.focal_length_px
    full_well_e: FullWellE = _TUNING.full_well_e
    read_noise_e: ReadNoiseE = _TUNING.read_noise_e
    metric_delta: MetricDelta = _TUNING.metric_delta
    metric_lambda: MetricLambda = _TUNING.metric_lambda
    balance_weight: BalanceWeight = _TUNING.balance_weight
    balance_offset: BalanceOffset = _TUNING.balance_offset
    mean_target: MeanTarget = _TUNING.mean_target
    bracket: BracketConfig | None = None

    def parameters(self) -> ControlParameters:
        """What the control loop is tuned with."""
        values = {field.name: getattr(self, field.name) for field in fields(ControlParameters)}
        found = {"flicker_hz": None} if self.flicker_hz == "auto" else {}
        bracketing = None if self.bracket is None else self.bracket.bracketing()
        return ControlParameters(**values | found | {"bracket": bracketing})

    @model_validator(mode="after")
    def _policy_exists(self) -> Self:
        check_policy_id(self.policy)
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
    def _wiring_fits_the_rig(self) -> Self:
        if self.trigger.mode == "free_run" and self.cameras.right is not None:
            raise ValueError("trigger.mode free_run is for one camera: two that run freely never see the same instant")
        if self.trigger.mode == "primary" and self.cameras.right is None:
            raise ValueError("trigger.mode primary needs two cameras: for a single one choose free_run")
        return self

    @model_validator(mode="after")
    def _regions_have_cameras(self) -> Self:
        if self.control.roi.right is not None and self.cameras.right is None:
            raise ValueError("control.roi.right is given, but cameras.right is not: remove it")
        return self

    @model_validator(mode="after")
    def _something_to_refine(self) -> Self:
        if self.response.refine and all(camera.response is None for camera in self.sides.values()):
            raise ValueError(
                "response.refine needs a response file to refine: give cameras.left.response, or remove it"
            )
        return self

    @model_validator(mode="after")
    def _an_imu_has_a_focal_length(self) -> Self:
        imu, focal_length_px = self.motion.imu, self.control.focal_length_px
        if imu is not None and focal_length_px is None:
            raise ValueError("motion.imu needs control.focal_length_px: give the left camera's focal length in pixels")
        if focal_length_px is not None and imu is None:
            raise ValueError("control.focal_length_px has no effect without motion.imu: give motion.imu, or remove it")
        return self

    @model_validator(mode="after")
    def _exposure_fits(self) -> Self:
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

        Raises
        ------
        ConfigurationError
            Naming key and file if a file cannot be used, or is for another camera or image format.
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

        Raises
        ------
        ConfigurationError
            Naming key and file if a file cannot be used, or is for another camera.
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

        Raises
        ------
        ConfigurationError
            Naming key and file if a file cannot be used, is for another camera, or does not fit the other camera's.
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

    @cached_property
    def vignettings(self) -> dict[Side, VignettingFile]:
        """The vignetting file of each camera that has one, read once.

        Raises
        ------
        ConfigurationError
            Naming key and file if a file cannot be used, or is for another camera.
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

        Raises
        ------
        ConfigurationError
            Naming key and file.
        """
        camera = self.sides[side]
        self.responses[side].check_belongs(camera.serial, description.pixel_format)
        if side in self.calibrations:
            with said_of(f"cameras.{side}.calibration: {camera.calibration}"):
                check_camera(self.calibrations[side], camera.serial, description.size)
        if side in self.vignettings:
            with said_of(f"cameras.{side}.vignetting"):
                self.vignettings[side].check_belongs(camera.serial, description.size)
