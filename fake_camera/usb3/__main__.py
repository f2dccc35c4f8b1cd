"""Runs a program that sees fake cameras of other processes: ``python -m fake_camera.usb3 SOCKET... -- COMMAND...``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from fake_camera.usb3.run import ShimError, client_environment

_USAGE = "usage: python -m fake_camera.usb3 SOCKET... -- COMMAND..."


def main(arguments: list[str]) -> int:
    """Become the command; returns 2, with one sentence on stderr, when that fails."""
    if "--" not in arguments[:-1]:
        print(_USAGE, file=sys.stderr)
        return 2
    end = arguments.index("--")
    sockets, command = arguments[:end], arguments[end + 1 :]
    try:
        environment = client_environment([Path(socket) for socket in sockets])
        os.execvpe(command[0], command, environment)
    except ShimError as error:
        print(error, file=sys.stderr)
    except OSError as error:
        print(f"{command[0]}: {error.strerror}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
