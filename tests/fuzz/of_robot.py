"""Parsers of what comes from a robot, and of the map files of its paths."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from autoexpose_daemon.control.inputs import LightSeries, TrackedCells
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.messages.inputs import light_ahead, odometry, registration, tracked_cells, twist, twist_stamped
from imaging.exposure import ExposureSetting
from navigation.maps.adaptation import adapt
from navigation.maps.path import TaughtPlace
from navigation.store import MapFile, MapInfo
from navigation.views.features import Features
from navigation.views.registration import register
from tests.autoexpose_daemon.samples import registered_view
from tests.fuzz.target import in_file

MAP = "run/lap.map"


def odometry_seeds() -> Iterator[bytes]:
    yield odometry((1.0, -2.0, 0.5), (0.4, 0.1), 1_700_000_000_000_000_000)


def velocity_seeds() -> Iterator[bytes]:
    yield twist((0.4, -0.1))
    yield twist_stamped((0.4, -0.1), 1_700_000_000_000_000_000)


def light_ahead_seeds() -> Iterator[bytes]:
    yield light_ahead(LightSeries(np.linspace(8.0, 14.0, 40), np.zeros(40), 20, 0.02, 0.05), 1_700_000_000_000_000_000)


def tracked_cells_seeds() -> Iterator[bytes]:
    counts = np.arange(48, dtype=np.uint16).reshape(6, 8)
    yield tracked_cells(TrackedCells("slam", 1_700_000_000_000_000_000, "left", 2 * counts, counts))


def registration_seeds() -> Iterator[bytes]:
    yield registration(registered_view())


def map_file(data: bytes) -> None:
    """Everything in it is read."""
    path = in_file(data, MAP)
    for log in ("-wal", "-shm"):
        path.with_name(path.name + log).unlink(missing_ok=True)
    with MapFile(path) as file:
        file.taught_path()
        for run in file.runs():
            file.light(run)
        for place in file.places():
            file.jpeg(place)
            file.history(place)
        file.lives()
        file.seen_shares()


def map_seeds() -> Iterator[bytes]:
    """Two local maps, one of them passed again."""
    path = in_file(b"", MAP)
    path.unlink()
    random = np.random.default_rng(1)
    features = Features(
        random.uniform(0.0, 500.0, (6, 2)), random.random(6), random.integers(0, 256, (6, 32)).astype(np.uint8)
    )
    with MapFile(path, MapInfo(720, 540, 600.0, "fast-orb", DEFAULT_POLICY)) as file:
        taught = file.begin_run("teach", 1_700_000_000.0)
        for where_m in (0.0, 0.2):
            place = TaughtPlace(where_m, b"jpeg", ExposureSetting(1000.0, 0.0), features)
            file.add_place(taught, place, [(where_m, 0.5, 0.1)])
        file.add_light(taught, [(0.0, 9.0, 0.0), (0.01, 9.5, -0.5)])
        again = file.begin_run("repeat", 1_700_000_900.0)
        first = file.places()[0]
        passing = adapt(first.map, features, register(first.map.features, features), "adaptive", first.next_feature)
        file.pass_place(again, first, passing, 1_700_000_901.0)
    yield path.read_bytes()
