"""Receives sets of frames and prints how each was exposed: python examples/client.py [ENDPOINT]

Run it beside the daemon, or beside `autoexpose demo --seconds 60 --publish`. For a daemon on another machine give its
endpoint, such as tcp/robot:7447.
"""

import contextlib
import sys

from autoexpose_daemon.client import RigClient


def main() -> None:
    """Print one line for each set, until Ctrl-C."""
    with RigClient("rig", connect=sys.argv[1:] or None) as client:
        for received in client:  # waits for a daemon, and finds it again after a restart
            exposures = ", ".join(
                f"{camera} {frame.setting.exposure_time_us:.0f} us {frame.setting.gain_db:.1f} dB, "
                f"mean grey {frame.grey8().mean():.0f}"
                for camera, frame in received.frames.items()
            )
            why = "" if received.decision is None else f"; next: {received.decision.reason}"
            print(f"trigger {received.trigger}: {exposures}{why}", flush=True)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
