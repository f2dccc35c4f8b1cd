"""How registration depends on exposure: the same views at nine exposures, without any policy."""

from __future__ import annotations

from evaluation.experiments.experiment import Plain
from evaluation.experiments.teach.daylight import REPLAYS, TEACHING
from evaluation.experiments.teach.operator_setting import at_half
from evaluation.experiments.teach.park import park
from evaluation.experiments.teach.path import TaughtPath
from evaluation.experiments.teach.registration import Truth
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import SimulatedCamera, time_first
from fake_camera.world.render.renderer import Renderer
from navigation.views.features import OrbPyramid
from navigation.views.registration import register

OFFSETS = tuple(range(-4, 5))
"""Stops from the exposure that holds the top half at 0.5."""

AHEAD = 0.2
"""Where a view is replayed: this share of the way from its map to the next."""


def sweep(seed: int, tilt_deg: float, light: str, maps: int) -> Plain:
    """Register one view near each map at all offsets.

    The map is taught with the top half at 0.5. Arguments as those of `replay.measure`.

    Returns
    -------
    For each map: `errors` (pixels, None where no shift was found) and `votes` at each of the `offsets`, and the offset
    at which the `whole` image has a mean of 0.5.
    """
    path, detector, camera = TaughtPath(seed, tilt_deg), OrbPyramid(), SimulatedCamera(2 * seed, 2 * seed)
    surfaces = park(seed, TEACHING)
    truth, before = Truth(surfaces), Renderer(surfaces, CAMERA)
    after, number = Renderer(park(seed, REPLAYS[light]), CAMERA), 1 + list(REPLAYS).index(light)
    errors: list[list[float | None]] = []
    votes: list[list[int]] = []
    whole: list[float] = []
    for index in range(maps):
        radiance = before.render(path.taught(index)[None], TEACHING.lux(0.0))
        taught = detector.find(camera.expose(radiance, at_half(camera, radiance, top_only=True), 2 * index), "top half")
        pose = path.repeated(number, (index + AHEAD) * path.spacing_m)
        shift = truth.shift(path.taught(index), pose)
        radiance = after.render(pose[None], REPLAYS[light].lux(index / maps))
        middle = at_half(camera, radiance, top_only=True).level
        whole.append(at_half(camera, radiance).level - middle)
        won = []
        for offset in OFFSETS:
            image = camera.expose(radiance, time_first(middle + offset), 2 * index + 1)
            won.append(register(taught, detector.find(image, "top half")).vote)
        errors.append([None if vote.shift_px is None else abs(vote.shift_px - shift) for vote in won])
        votes.append([vote.votes for vote in won])
    return {"offsets": list(OFFSETS), "errors": errors, "votes": votes, "whole": whole}
