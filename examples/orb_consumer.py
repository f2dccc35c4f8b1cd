"""Matches ORB features between left and right, pair by pair: python examples/orb_consumer.py

Run it beside the daemon, or beside `autoexpose demo --seconds 60 --publish`.
"""

from __future__ import annotations

import argparse
import contextlib

import cv2

from autoexpose_daemon.client import StereoClient


def main() -> None:
    """Count matches until stopped."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rig", default="rig")
    parser.add_argument("--pairs", type=int, help="stop after so many pairs")
    options = parser.parse_args()
    orb = cv2.ORB_create(nfeatures=300)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    with StereoClient(options.rig) as client:
        for number, pair in enumerate(client, start=1):
            assert pair.right is not None  # a rig of two cameras
            _, left = orb.detectAndCompute(pair.left.grey8(), None)
            _, right = orb.detectAndCompute(pair.right.grey8(), None)
            matches = [] if left is None or right is None else matcher.match(left, right)
            if number % 60 == 0:
                print(f"{len(matches)} matches at {pair.left.setting}; {client.tally}", flush=True)
            if number == options.pairs:
                return


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
