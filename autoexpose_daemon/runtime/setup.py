"""From configuration to opened cameras; the tuning that may change while they run, and the loop built from it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from functools import partial

from pydantic import ValidationError

from autoexpose_daemon.config.control import region_of
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import camera_setup
from autoexpose_daemon.config.request import Request
from autoexpose_daemon.config.section import error_sentences
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.image import Region
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.step import StepInputs
from drivers.aravis import open_camera
from drivers.camera import Camera, CameraDescription
from drivers.rig.events import CameraReady
from drivers.setup import CameraSetup
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits
from imaging.frames import CameraName, FrameSet
from imaging.geometry import CameraGeometry
from imaging.pixels import plane_shape
from imaging.python310 import Self


class Tuning:
    """Bounds, policy, parameters, regions and the cameras' calibrations; reads files unless the configuration has.

    Raises ConfigurationError when one of the files cannot be used.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        # Those that were read for the whole rig may be of other cameras than a part of it has.
        self.responses = {camera: config.responses[camera].response for camera in config.cameras}
        self.calibrations = {name: it for name, it in config.calibrations.items() if name in config.cameras}
        self.vignettings = {name: it.vignetting for name, it in config.vignettings.items() if name in config.cameras}
        self.regions = {name: region for name, region in config.control.regions.items() if name in config.cameras}

    def of_group(self, group: str) -> Tuning:
        """That of a group's cameras: itself, if there is no other group."""
        part = self.config.of_group(group)
        return self if part is self.config else Tuning(part)

    def changed(self, request: Request) -> Self:
        """This tuning with a request's changes, or itself; ConfigurationError if that is not a valid configuration.

        Reads no files.
        """
        config, regions = self.config, self._requested_regions(request)
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

    def calibrated(self, geometries: Mapping[CameraName, CameraGeometry | None]) -> Self:
        """This tuning with the geometry of some cameras; None: not calibrated."""
        tuning = copy(self)
        known = {**self.calibrations, **geometries}
        tuning.calibrations = {name: it for name in self.config.cameras if (it := known.get(name)) is not None}
        return tuning

    def differs_from(self, other: Tuning) -> tuple[str, ...]:
        """What differs, in words."""
        ours, theirs = self.config, other.config
        named = {"policy": ours.control.policy != theirs.control.policy, "limits": ours.exposure != theirs.exposure}
        named |= {
            f"region {camera}": self.regions.get(camera) is not other.regions.get(camera) for camera in ours.cameras
        }
        return tuple(name for name, differs in named.items() if differs)

    def _requested_regions(self, request: Request) -> dict[CameraName, Region]:
        asked = {camera: region_of(f"region.{camera}", area) for camera, area in request.regions.items()}
        for camera in asked.keys() - self.config.cameras.keys():
            raise ConfigurationError(f"region.{camera}: the rig has no {camera} camera: leave it out")
        return self.regions | asked

    def limits(self, cameras: Mapping[CameraName, ExposureLimits]) -> ExposureLimits:
        """The bounds, cut to those of the cameras; raises ConfigurationError if nothing is left."""
        limits = self.config.exposure.limits()
        for name, own in cameras.items():
            try:
                limits = limits.within(own)
            except ConfigurationError as error:
                offset_stops = self.config.cameras[name].offset_stops
                less = f" with its offset_stops of {offset_stops:g} taken off" if offset_stops else ""
                raise ConfigurationError(
                    f"exposure: {error}; the {name} camera takes {own.min_time_us:g} to {own.max_time_us:g} us, "
                    f"{own.min_gain_db:g} to {own.max_gain_db:g} dB{less}"
                ) from error
        return limits

    def check_region(self, name: CameraName, camera: CameraDescription) -> None:
        """Refuse a region that does not fit what a camera sends; raises ConfigurationError."""
        region = self.regions.get(name)
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


def openers(config: Config) -> dict[CameraName, Callable[[], Camera]]:
    """For each side of the rig, a function that opens its camera as configured."""
    tuning = Tuning(config)
    return {camera: partial(_open, tuning, camera, camera_setup(config, camera)) for camera in config.cameras}


def refusals(config: Config) -> Iterator[tuple[CameraName, AutoexposeError | None]]:
    """Why each side's camera cannot be opened, set up and exposed as configured, or None; it is closed again."""
    for camera, opener in openers(config).items():
        try:
            opener().close()
        except AutoexposeError as error:
            yield camera, error
        else:
            yield camera, None


def _open(tuning: Tuning, name: CameraName, setup: CameraSetup) -> Camera:
    """Open a camera; refuse one that is not as files, limits or regions need it."""
    camera = open_camera(tuning.config.cameras[name].serial, setup)
    try:
        tuning.config.check_frames(name, camera.description)
        tuning.limits({name: camera.limits})
        tuning.check_region(name, camera.description)
    except ConfigurationError:
        camera.close()
        raise
    return camera


def _try_out(loop: ControlLoop, newest: FrameSet) -> None:
    """Have a loop decide before it is needed: nobody's request for a policy ends the daemon."""
    try:
        loop.step(newest)
    except ConfigurationError:
        raise
    except Exception as error:  # of a policy that may be another package's
        what = f"{type(error).__name__}: {error}"
        raise ConfigurationError(f"policy {loop.setup.policy_id} fails on the present frames: {what}") from error


log = logging.getLogger(__name__)

_ROUNDING_STOPS = 0.05
"""Brackets that are clipped by less are not worth a word."""


class ActiveLoop:
    """The loop that decides: built when cameras are ready, and rebuilt when their limits or the tuning change."""

    def __init__(self, tuning: Tuning) -> None:
        self.tuning = tuning  # what the loop is built from, apart from the cameras' limits
        self.loop: ControlLoop | None = None  # until a camera is ready
        self._limits: dict[CameraName, ExposureLimits] = {}
        self.cameras: dict[CameraName, CameraDescription] = {}  # that have been ready
        self._newest: FrameSet | None = None

    def ready(self, event: CameraReady) -> None:
        """Take over the limits of a camera; raises ConfigurationError if no common range is left."""
        self._limits[event.camera] = event.limits
        self.cameras[event.camera] = event.description
        limits = self.tuning.limits(self._limits)
        if self.loop is None or limits != self.loop.setup.limits:
            self._install(self.tuning.loop(limits))

    def tune(self, tuning: Tuning) -> None:
        """Switch to another tuning; ConfigurationError, with nothing changed, if it does not fit cameras or frames."""
        self.use(tuning, self.prepared(tuning))

    def prepared(self, tuning: Tuning) -> ControlLoop:
        """The loop of another tuning, for `use`; ConfigurationError if it does not fit cameras or frames."""
        for name, camera in self.cameras.items():
            tuning.config.check_frames(name, camera)
        loop = tuning.loop(tuning.limits(self._limits))
        for name, camera in self.cameras.items():
            tuning.check_region(name, camera)
        if self._newest is not None:
            _try_out(loop, self._newest)
        return loop

    def use(self, tuning: Tuning, loop: ControlLoop) -> None:
        """Switch to another tuning and its loop."""
        self.tuning = tuning
        if self._limits:
            self._install(loop)

    def step(self, inputs: StepInputs) -> Decision | None:
        """Decide; None before a camera is ready."""
        if self.loop is None:
            return None
        known_hz = self.loop.flicker_hz
        decision = self.loop.step(inputs)
        if (flicker_hz := self.loop.flicker_hz) is None and known_hz is not None:
            log.info("the light no longer flickers: any exposure time")
        elif flicker_hz != known_hz:
            log.info("the light flickers at %g Hz: exposure times of whole periods, where they fit", flicker_hz)
        self._newest = inputs.pair
        return decision

    def _install(self, loop: ControlLoop) -> None:
        limits = loop.setup.limits
        log.info(
            "exposure within %g to %g us, %g to %g dB",
            limits.min_time_us, limits.max_time_us, limits.min_gain_db, limits.max_gain_db,
        )  # fmt: skip
        bracketing = self.tuning.config.control.bracket
        room = limits.brightest.level - limits.darkest.level
        if bracketing is not None and bracketing.range_stops > room + _ROUNDING_STOPS:
            log.warning(
                "brackets of %.1f stops do not fit into the %.1f stops of these limits, and their outer shots are "
                "clipped: widen `exposure`, or narrow the brackets", bracketing.range_stops, room,
            )  # fmt: skip
        self.loop = loop
