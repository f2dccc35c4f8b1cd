"""Tells the daemon of a tunnel two seconds ahead, so that it is exposed for in time: python examples/light_ahead.py

`autoexpose repeat` does this with what it saw when it was taught; this is for a robot with a map of its own.
"""

import contextlib
import sys
import time

import numpy as np

from autoexpose_daemon.client import LightSeries, RigClient

STEP_S, BEHIND, AHEAD = 0.1, 15, 30  # places along the way, from a second and a half behind to three seconds ahead
ENTRANCE_S, TUNNEL_STOPS = 2.0, -5.0


def light_ahead(now: float) -> LightSeries:
    """What the map says around here, if the rig came to this place at 0 s and drives on as it does."""
    times_s = now + STEP_S * np.arange(-BEHIND, AHEAD)
    risen = np.where(times_s < ENTRANCE_S, 0.0, TUNNEL_STOPS)  # by how much the light has risen, stops
    return LightSeries(levels=12.0 - risen, risen=risen, now=BEHIND, step_s=STEP_S, spread_s=0.05)


def main() -> None:
    """Tell it with every set, until Ctrl-C."""
    with RigClient("rig", connect=sys.argv[1:] or None) as client:
        begun_s = time.monotonic()
        for received in client:
            client.send_light_ahead(light_ahead(time.monotonic() - begun_s))
            print(f"trigger {received.trigger}: exposed at {received.level:.2f} stops", flush=True)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
