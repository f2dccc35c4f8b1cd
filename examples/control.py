"""Locks the exposure, corrects it and bounds it while the daemon runs: python examples/control.py [ENDPOINT]

Each call waits for the daemon's answer, and raises AutoexposeError with its sentence when nothing has changed.
"""

import sys

from autoexpose_daemon.client import AutoexposeError
from autoexpose_daemon.client.control_client import ControlClient


def main() -> None:
    """Change one thing after another, and leave everything as it was."""
    with ControlClient("rig", connect=sys.argv[1:] or None, name="example") as control:
        print("locked at", control.lock().requests.locked)
        control.unlock()
        print("EV", control.ev(-0.5).requests.ev_stops)
        print("may choose", control.limits(max_time_us=4000).requests.bounds)
        try:
            control.policy("no-such-policy")
        except AutoexposeError as refusal:
            print("refused:", refusal)
        print("changed:", control.reset().requests.changed or "nothing, after a reset")


if __name__ == "__main__":
    try:
        main()
    except AutoexposeError as error:
        sys.exit(str(error))
