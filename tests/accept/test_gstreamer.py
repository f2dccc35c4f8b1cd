"""GStreamer's `aravissrc`, Debian's own, on our cameras: a pipeline without a display takes what it knows."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fake_camera.bench.cameras import gige_camera
from tests.accept.commands import output

FRAMES = 8
PIXELS = 720 * 540

FORMATS = {
    "Mono8": ("video/x-raw,format=GRAY8", 1),
    "Mono16": ("video/x-raw,format=GRAY16_LE", 2),
    "BayerRG8": ("video/x-bayer,format=rggb", 1),
    "RGB8": ("video/x-raw,format=RGB", 3),
    "YUV422_8": ("video/x-raw,format=YUY2", 2),
}
"""What `aravissrc` 0.8.26 calls a format, and its bytes per pixel."""


def run_pipeline(address: str, caps: str, file: Path) -> None:
    listed = output("arv-tool-0.8", timeout_s=30)
    name = next(line.split(" (")[0] for line in listed.splitlines() if address in line)
    source = ["aravissrc", f"camera-name={name}", f"num-buffers={FRAMES}", "packet-resend=true"]
    # As root, Aravis would take a packet socket, which receives nothing on loopback (docs/do/fake-camera.md).
    without = ["setpriv", "--bounding-set=-net_raw", "--inh-caps=-net_raw"] if os.geteuid() == 0 else []
    output(*without, "gst-launch-1.0", *source, "!", caps, "!", "filesink", f"location={file}", timeout_s=60)


@pytest.mark.parametrize("pixel_format", FORMATS)
def test_a_pipeline_gets_whole_frames(pixel_format: str, tmp_path: Path) -> None:
    caps, sample_bytes = FORMATS[pixel_format]
    with gige_camera(options=["--pixel-format", pixel_format]) as camera:
        run_pipeline(camera.address, caps, tmp_path / "frames")
    written = (tmp_path / "frames").read_bytes()
    assert len(written) == FRAMES * sample_bytes * PIXELS
    last = written[-sample_bytes * PIXELS :]
    assert len(set(last)) > 20  # a picture, not a blank
