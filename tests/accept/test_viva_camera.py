"""A camera that neither we nor Aravis wrote: the GigE fake of viva-genicam, in this process.

It has an exposure time in us, gain without a unit, chunk data, Line1, and what it can be made to do wrong. It names
0.0.0.0 as its address, because it listens on all, and so answers, and sends, from another. Its USB3 fake
(`FakeU3vCamera`) is on no bus: only its own library opens it, and there is nothing for our driver to find.
"""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivers.aravis import AravisCamera, open_camera
from drivers.camera import IncompleteFrame
from drivers.setup import CameraSetup, TriggerSetup
from imaging.errors import CameraLostError, ConfigurationError, NodeError, UnsupportedCameraError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from tests.fake_camera.gige.foreign_clients import viva_module
from tests.fakes import first_address

SERIAL = "FAKE-001"
PATIENCE_S = 20.0
FREE_RUN = CameraSetup(TriggerSetup("free_run", rate_hz=30.0))
Outcome = Frame | IncompleteFrame


@contextlib.contextmanager
def viva_camera(**options: Any) -> Iterator[Any]:
    viva_module()
    from viva_genicam.testing import FakeGigeCamera  # noqa: PLC0415  (where it is installed)

    with first_address(), FakeGigeCamera(bind_ip="0.0.0.0", **options) as fake:
        yield fake


@contextlib.contextmanager
def driven(setup: CameraSetup = FREE_RUN, **options: Any) -> Iterator[tuple[Any, AravisCamera]]:
    with viva_camera(**options) as fake, contextlib.closing(open_camera(SERIAL, setup)) as camera:
        camera.start()
        yield fake, camera


def outcomes_until(camera: AravisCamera, enough: Callable[[Outcome], bool]) -> list[Outcome]:
    outcomes: list[Outcome] = []
    deadline_s = time.monotonic() + PATIENCE_S
    while not (outcomes and enough(outcomes[-1])):
        assert time.monotonic() < deadline_s, f"in vain: {outcomes[-3:]}"
        if (outcome := camera.next_frame(0.2)) is not None:
            outcomes.append(outcome)
    return outcomes


def test_its_exposure_is_driven_and_its_gain_is_not() -> None:
    with driven() as (fake, camera):
        limitations = " ".join(camera.description.limitations)
        assert "gain (Gain) is in numbers without a unit and not driven" in limitations
        assert "no chunk data" not in limitations
        outcomes_until(camera, lambda outcome: isinstance(outcome, Frame))
        asked = ExposureSetting(2345.0, 0.0)
        assert camera.write(asked) == asked
        (stored,) = struct.unpack(">d", fake.peek(fake.REGISTERS["ExposureTime"], 8))
        assert stored == asked.exposure_time_us
        frame = outcomes_until(camera, lambda it: isinstance(it, Frame) and it.setting == asked)[-1]
        assert isinstance(frame, Frame)
        assert frame.setting_source == "chunk"
        assert frame.pixels.shape == (480, 640)
        with pytest.raises(NodeError, match="no gain known in dB"):
            camera.write(ExposureSetting(2345.0, 3.0))
        assert camera.refused_packets() is None
        camera.close()
        assert fake.controller() is None


def test_each_software_trigger_makes_a_frame() -> None:
    with driven(CameraSetup(TriggerSetup("software", rate_hz=30.0))) as (fake, camera):
        for count in range(1, 6):
            camera.trigger()
            outcomes_until(camera, lambda outcome: isinstance(outcome, Frame))
            assert fake.software_triggers() == count


def test_what_it_has_not_is_refused_in_a_sentence() -> None:
    with viva_camera(), pytest.raises(ConfigurationError, match="no trigger line 'Line0'; it has Line1"):
        open_camera(SERIAL, CameraSetup(TriggerSetup("external", "Line0", rate_hz=30.0)))
    with viva_camera(pixel_format="Mono12p"), pytest.raises(UnsupportedCameraError, match="Mono8 or Mono16"):
        open_camera(SERIAL, FREE_RUN)


def test_packets_that_are_never_sent_cost_their_frames_and_no_other() -> None:
    """A leader and a payload packet, of a camera without packet resend."""
    with driven(packet_resend=False, drop_packets=[(5, 0), (10, 3)]) as (_, camera):
        outcomes = outcomes_until(camera, lambda outcome: outcome.frame_id >= 25)
        whole = {outcome.frame_id for outcome in outcomes if isinstance(outcome, Frame)}
        assert not whole & {5, 10}
        assert len(whole) >= 15


def test_control_that_the_camera_takes_away_is_noticed() -> None:
    with driven() as (fake, camera):
        outcomes_until(camera, lambda outcome: isinstance(outcome, Frame))
        fake.revoke_control()
        deadline_s = time.monotonic() + PATIENCE_S
        with pytest.raises(CameraLostError):
            while time.monotonic() < deadline_s:
                camera.next_frame(0.2)


def test_a_slow_acknowledgement_is_waited_for() -> None:
    module = viva_module()
    register = module.testing.FakeGigeCamera.REGISTERS["ExposureTime"]
    with driven(delay_ack={register: 0.3}) as (_, camera):
        outcomes_until(camera, lambda outcome: isinstance(outcome, Frame))
        began_s = time.monotonic()
        asked = ExposureSetting(1234.0, 0.0)
        assert camera.write(asked) == asked
        assert time.monotonic() - began_s >= 0.3
