"""From configuration to opened cameras, and the tuning that may change while they run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from functools import partial

from pydantic import ValidationError

from autoexpose_daemon.config.control import region_of
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import camera_setup
from autoexpose_daemon.config.request import RegionRequest, Request
from autoexpose_daemon.config.section import AreaConfig, error_sentences
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.region import Region
from autoexpose_daemon.control.setup import ControlSetup
from drivers.aravis import open_camera
from drivers.camera import Camera, CameraDescription
from drivers.setup import CameraSetup
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits
from imaging.frames import SIDES, Side
from imaging.pixels import plane_shape
from imaging.python310 import Self


class Tuning:
    """Bounds, policy, parameters, regions and the cameras' calibrations; reads files unless the configuration has.

    Raises ConfigurationError when one of the files cannot be used.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.responses = {side: file.response for side, file in config.responses.items()}
        self.calibrations = config.calibrations
        self.vignettings = {side: file.vignetting for side, file in config.vignettings.items()}
        self.regions = config.control.roi.regions

    def changed(self, request: Request) -> Self:
        """This tuning with a request's changes, or itself; ConfigurationError if that is not a valid configuration.

        Reads no files.
        """
        config, regions = self.config, self._requested_regions(request.region)
        control, exposure = config.control, config.exposure
        if request.policy is not None:
            control = control.model_copy(update={"policy": request.policy})
        if request.limits is not None:
            exposure = exposure.model_copy(update=request.limits.model_dump(exclude_none=True))
        if (control, exposure, regions) == (config.control, config.exposure, self.regions):
            return self
        exposure.limits()
        sections = {"control": control, "exposure": exposure}
        # The start setting no longer counts, except for the policy that stays there.
        checked = control if control.policy == "fixed" else control.model_copy(update={"start": None})
        try:
            others = {name: getattr(config, name) for name in Config.model_fields}
            Config.model_validate(others | sections | {"control": checked})  # whether the sections fit each other
        except ValidationError as error:
            raise ConfigurationError(error_sentences(error, Config)[0]) from error
        tuning = copy(self)
        # The copy keeps the responses, which are read once.
        tuning.config, tuning.regions = config.model_copy(update=sections), regions
        return tuning

    def differs_from(self, other: Tuning) -> tuple[str, ...]:
        """What differs, in words."""
        ours, theirs = self.config, other.config
        named = {"policy": ours.control.policy != theirs.control.policy, "limits": ours.exposure != theirs.exposure}
        named |= {f"region {side}": self.regions.get(side) is not other.regions.get(side) for side in SIDES}
        return tuple(name for name, differs in named.items() if differs)

    def _requested_regions(self, request: RegionRequest | None) -> dict[Side, Region]:
        areas: dict[Side, AreaConfig | None] = {}
        if request is not None:
            areas = {"left": request.left, "right": request.right}
        asked = {side: region_of(f"region.{side}", area) for side, area in areas.items() if area is not None}
        for side in asked.keys() - self.config.sides.keys():
            raise ConfigurationError(f"region.{side}: the rig has no {side} camera: leave it out")
        return self.regions | asked

    def check_belongs(self, cameras: Mapping[Side, CameraDescription]) -> None:
        """Refuse files made for a pixel format or size that a camera does not send; raises ConfigurationError."""
        for side, description in cameras.items():
            self.config.check_frames(side, description)

    def limits(self, cameras: Iterable[ExposureLimits]) -> ExposureLimits:
        """The bounds, cut to those of the cameras; raises ConfigurationError if nothing is left."""
        limits = self.config.exposure.limits()
        for own in cameras:
            try:
                limits = limits.within(own)
            except ConfigurationError as error:
                raise ConfigurationError(
                    f"exposure: {error}; the camera takes {own.min_time_us:g} to {own.max_time_us:g} us, "
                    f"{own.min_gain_db:g} to {own.max_gain_db:g} dB"
                ) from error
        return limits

    def check_region(self, side: Side, camera: CameraDescription) -> None:
        """Refuse a region that does not fit what a camera sends; raises ConfigurationError."""
        region = self.regions.get(side)
        if region is not None and camera.size is not None and camera.pixel_format is not None:
            width, height = camera.size
            region.weights((height, width), plane_shape((height, width), camera.pixel_format.layout))

    def loop(self, limits: ExposureLimits) -> ControlLoop:
        """A new control loop."""
        control, start = self.config.control, self.config.start
        return ControlLoop(
            ControlSetup(
                control.policy, self.responses, limits, start, control.parameters(), self.regions, self.vignettings
            )
        )


def openers(config: Config) -> dict[Side, Callable[[], Camera]]:
    """For each side of the rig, a function that opens its camera as configured."""
    tuning = Tuning(config)
    return {side: partial(_open, tuning, side, camera_setup(config, side)) for side in config.sides}


def refusals(config: Config) -> Iterator[tuple[Side, AutoexposeError | None]]:
    """Why each side's camera cannot be opened, set up and exposed as configured, or None; it is closed again."""
    for side, opener in openers(config).items():
        try:
            opener().close()
        except AutoexposeError as error:
            yield side, error
        else:
            yield side, None


def _open(tuning: Tuning, side: Side, setup: CameraSetup) -> Camera:
    """Open a camera; refuse one that is not as files, limits or regions need it."""
    camera = open_camera(tuning.config.sides[side].serial, setup)
    try:
        tuning.config.check_frames(side, camera.description)
        tuning.limits([camera.limits])
        tuning.check_region(side, camera.description)
    except ConfigurationError:
        camera.close()
        raise
    return camera
