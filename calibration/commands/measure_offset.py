"""The command `autoexpose calibrate offset`: by how much less light reaches each camera than another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from calibration.commands.rig import (
    CameraMode,
    Cameras,
    check_new,
    check_rig,
    chosen_rig,
    give_sections,
    print_judged,
    progress_of,
    response_of,
)
from calibration.offset import Looks, WallLook, centre, judge_looks, judge_offset, look_at_wall, solve_offset
from calibration.session import Session
from documents.command_line import AsJson, CommandOutput, ConfigFile, ConfigOption
from drivers.aravis import open_camera
from imaging.errors import ConfigurationError
from imaging.frames import CameraName

DECIMALS = 2


def offset(
    context: typer.Context,
    config_file: ConfigFile = None,
    *,
    camera: Cameras = None,
    config: ConfigOption = None,
    reference: Annotated[str | None, typer.Option(help="Name of the camera that keeps 0 (the first).")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="A new file for the offsets.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure by how much less light reaches each camera than the first, from a wall that all of them look at."""
    console = CommandOutput(context, as_json)
    rig = chosen_rig(camera, config_file, config)
    check_rig(rig)
    check_new(output)
    first = _reference(rig, reference)
    order = [first, *(mode for mode in rig if mode is not first)]
    looks, driven = _look_there_and_back(order, console)
    judged = {name: list(judge_looks(each)) for name, each in looks.items()}
    facts = [*_facts(first, looks[first.name]), ("offset", "0 stops: the others are compared with this one")]
    if print_judged(facts, judged[first.name], console) == "refused":
        raise typer.Exit(1)
    offsets = {first.name: 0.0}
    for mode in order[1:]:
        facts, findings = [*_facts(mode, looks[mode.name])], judged[mode.name]
        if not any(finding.severity == "refused" for finding in findings):
            found = solve_offset(looks[first.name], looks[mode.name])
            facts.append(("offset", f"{found.stops:.3f} stops, give or take {found.error_stops:.3f}"))
            findings += judge_offset(found, driven[mode.name])
        if print_judged(facts, findings, console) != "refused":
            offsets[mode.name] = round(found.stops, DECIMALS)
    sections: dict[str, Any] = {
        mode.name: {"serial": mode.serial, "offset_stops": offsets[mode.name]} for mode in rig if mode.name in offsets
    }
    give_sections(sections, output, console)
    if len(sections) < len(rig):
        raise typer.Exit(1)


def _reference(rig: Sequence[CameraMode], name: str | None) -> CameraMode:
    """The camera that the others are compared with."""
    if len(rig) < 2:
        raise ConfigurationError(f"an offset is between cameras, but only {rig[0].name} is given: name two or more")
    chosen = next((mode for mode in rig if name in (None, mode.name)), None)
    if chosen is None:
        names = ", ".join(mode.name for mode in rig)
        raise ConfigurationError(f"--reference {name}: the cameras are {names}")
    return chosen


def _look_there_and_back(
    order: Sequence[CameraMode], console: CommandOutput
) -> tuple[dict[CameraName, Looks], dict[CameraName, bool]]:
    """Two looks of each camera, one camera at a time, and whether its gain is driven."""
    responses = {mode.name: response_of(mode.response, mode.serial) for mode in order}
    there: dict[CameraName, WallLook] = {}
    looks: dict[CameraName, Looks] = {}
    driven: dict[CameraName, bool] = {}
    with progress_of("looks at the wall", console, 2 * len(order)) as update:
        for mode in (*order, *reversed(order)):
            before = there.get(mode.name)
            # As it is, without an offset: what is found is all of it.
            with Session(open_camera(mode.serial, mode.setup()), centre) as session:
                setting = None if before is None else before.setting
                look = look_at_wall(session, responses[mode.name], setting)
                driven[mode.name] = session.description.gain_node is not None
            if before is None:
                there[mode.name] = look
            else:
                looks[mode.name] = before, look
            update(advance=1)
    return looks, driven


def _facts(mode: CameraMode, looks: Looks) -> Iterator[tuple[str, str]]:
    yield "camera", f"{mode.name}, {mode.serial}"
    yield "light of the wall", f"{looks[0].light.mean():.3f} of full scale at {looks[0].setting}"
