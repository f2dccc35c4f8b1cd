"""Sweeping a camera, or reading a sweep's images, with the progress in the terminal."""

from __future__ import annotations

from datetime import datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.commands.rig import CameraMode
from calibration.document import CameraIdentity
from calibration.response.file import Origin
from calibration.result import Result, calibrate
from calibration.sources.session import Session
from calibration.sources.sweep import Shot, Sweep
from calibration.sources.sweep_plan import SweepPlan, plan_sweep
from drivers.aravis import open_camera
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.python310 import UTC


def measure_camera(mode: CameraMode, gain_db: float, console: Console) -> Result:
    """Sweep the exposure time of a camera that looks at a static scene, and solve the sweep.

    Raises
    ------
    CameraError, ConfigurationError
        When the camera cannot be opened, or fails.
    """
    with Session(open_camera(mode.serial, mode.setup())) as session:
        check_gain(session, gain_db)
        plan, camera = plan_sweep(session, gain_db), session.description
        sweep = Sweep(take(session, plan, mode.serial, console))
        origin = Origin(
            CameraIdentity(camera.vendor, camera.model, camera.serial),
            camera.pixel_format,
            mode.binning,
            sweep.shots[0].setting.gain_db,
            datetime.now(UTC).replace(microsecond=0),
            tool(),
        )
        brighter = partial(_brighter, session, plan, mode.serial, console)
        return calibrate(f"camera {camera.serial}", origin, sweep, camera.limitations, brighter)


def _brighter(session: Session, plan: SweepPlan, name: str, console: Console) -> tuple[Shot, ...]:
    """The sweep at a higher gain, if the camera has one."""
    brighter = plan.brighter(session.limits)
    if brighter is None:
        return ()
    gain_db = brighter.settings[0].gain_db
    console.print(
        f"camera {name}: the scene has one brightness only: again at {gain_db:.1f} dB, to check the exposure times",
        soft_wrap=True,
    )
    return take(session, brighter, name, console)


def measure_images(source: Path) -> Result:
    """Solve the sweep that a folder or a list of images holds; the camera is unknown."""
    from calibration.sources.images import read_images  # noqa: PLC0415  it needs pillow, from the extra

    origin = Origin(date=datetime.now(UTC).replace(microsecond=0), tool=tool())
    return calibrate(f"the images of {source}", origin, read_images(source))


def take(session: Session, plan: SweepPlan, name: str, console: Console) -> tuple[Shot, ...]:
    """Take the shots of a plan under a progress bar with the time left."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("left"), TimeRemainingColumn())
    shots: list[Shot] = []
    try:
        with Progress(*columns, console=console, speed_estimate_period=60.0) as progress:
            bar = progress.add_task(f"camera {name}", total=sum(map(plan.seconds, plan.settings)))
            for setting, taken in plan.run(session):
                shots += taken
                progress.update(
                    bar, advance=plan.seconds(setting), description=f"camera {name}: {setting.exposure_time_us:.0f} us"
                )
    except KeyboardInterrupt:
        raise AutoexposeError(f"camera {name}: stopped before the sweep was done: nothing was written") from None
    return tuple(shots)


def check_gain(session: Session, gain_db: float) -> None:
    """Refuse a gain that the camera does not have."""
    limits, serial = session.limits, session.description.serial
    if not limits.min_gain_db <= gain_db <= limits.max_gain_db:
        raise ConfigurationError(
            f"camera {serial}: its gain is {limits.min_gain_db:g} to {limits.max_gain_db:g} dB, not {gain_db:g} dB: "
            "give another with --gain-db"
        )


def tool() -> str:
    """Name and version of this program."""
    return f"autoexpose-daemon {version('autoexpose-daemon')}"
