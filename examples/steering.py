"""Tracks corners from frame to frame and tells the daemon where, which exposes for them: python examples/steering.py

`autoexpose top` then shows `steered by corners`. More in docs: "Consumers steer".
"""

import contextlib
import sys

import cv2

from autoexpose_daemon.client import RigClient, count_by_cell


def main() -> None:
    """Report on every set, until Ctrl-C."""
    with RigClient("rig", connect=sys.argv[1:] or None, name="corners", cameras=["left"]) as client:
        before = None
        for received in client:
            image = received.frames["left"].grey8()
            height, width = image.shape
            if before is not None:
                corners = cv2.goodFeaturesToTrack(before, maxCorners=300, qualityLevel=0.01, minDistance=7)
                if corners is not None:
                    _, found, _ = cv2.calcOpticalFlowPyrLK(before, image, corners, None)
                    looked_for = count_by_cell(corners, width, height)
                    fits = count_by_cell(corners[found == 1], width, height)
                    client.send_tracking(received.stamp_ns, looked_for, fits)
                    print(
                        f"trigger {received.trigger}: {fits.sum()} of {looked_for.sum()} corners followed", flush=True
                    )
            before = image


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
