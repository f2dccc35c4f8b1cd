"""Reads what `autoexpose record` wrote, step by step, with its frames: python examples/read_recording.py RUN.mcap

Needs the extra `record`, and no ROS. Frames are arrays; requests and reasons are text.
"""

import sys
from pathlib import Path

from autoexpose_daemon.client import AutoexposeError
from autoexpose_daemon.recording.file import Setup, Step
from autoexpose_daemon.recording.read import Recording


def main(path: Path) -> None:
    """Print one line for each step of control."""
    recording = Recording(path)
    for item in recording:
        match item:
            case Setup():
                print(f"policy {item.control.policy_id}, within {item.control.limits}")
            case Step():
                for request in item.requests:
                    print(f"trigger {item.pair.trigger}: {request}")
                means = {camera: round(frame.grey8().mean()) for camera, frame in item.pair.frames.items()}
                was, decided = item.pair.reference.setting, item.decision
                print(
                    f"trigger {item.pair.trigger}: at {was} mean grey {means}; next {decided.setting}: {decided.reason}"
                )
    print(f"dropped by the recorder: {recording.dropped}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except AutoexposeError as error:
        sys.exit(str(error))
