"""Fast DDS, by which ROS 2 talks unless told otherwise, gets the images that `autoexpose ros2` offers, bit for bit."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import threading
import zlib
from pathlib import Path
from typing import Any

import psutil
import pytest

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.demo.reference_step import reference_step_ms
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE

HERE = Path(__file__).with_name("fast_dds")
ENVIRONMENT = {**os.environ, "ROS_DOMAIN_ID": "217", "ROS_LOCALHOST_ONLY": "1"}
SECONDS = 60
STARTING_S = 20
LITERAL_MS, CORE_SHARE = 3.0, 0.25

pytestmark = [pytest.mark.needs("fastddsgen", "g++"), pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def subscriber(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made by Fast DDS from the definition of Image as ROS 2 has it."""
    folder = tmp_path_factory.mktemp("fast_dds")
    for file in ("Image.idl", "subscriber.cpp"):
        shutil.copy(HERE / file, folder)
    subprocess.run(["fastddsgen", "-replace", "Image.idl"], cwd=folder, check=True, capture_output=True)
    sources = ["subscriber.cpp", "Image.cxx", "ImagePubSubTypes.cxx"]
    command = ["g++", "-O2", "-std=c++17", "-o", "subscriber", *sources, "-lfastrtps", "-lfastcdr"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "subscriber"


def follow(client: StereoClient, sums: dict[tuple[str, str], int]) -> None:
    """Keep the sum of every left image that the daemon sends, by its stamp as Fast DDS prints it."""
    for pair in client:
        seconds, nanoseconds = divmod(pair.stamp_ns, 1_000_000_000)
        sums[str(seconds), str(nanoseconds)] = zlib.crc32(pair.left.pixels.tobytes())


@pytest.mark.parametrize("reliability", ["best_effort", "reliable"])
def test_fast_dds_gets_the_images_bit_for_bit(subscriber: Path, reliability: str, tmp_path: Path) -> None:
    sums: dict[tuple[str, str], int] = {}
    with contextlib.ExitStack() as running:

        def start(*command: Any, output: Any = subprocess.PIPE) -> subprocess.Popen[str]:
            process = subprocess.Popen(list(map(str, command)), env=ENVIRONMENT, stdout=output, text=True)
            running.callback(process.kill)
            return process

        bridge = start(*AUTOEXPOSE, "ros2", *(["--reliable"] if reliability == "reliable" else []))
        heard = running.enter_context((tmp_path / "heard").open("w+"))
        listening = [subscriber, 217, "rt/rig/left/image_raw", reliability, SECONDS + STARTING_S]
        listener = start(*listening, output=heard)
        demo = start(*AUTOEXPOSE, "demo", "--seconds", SECONDS, "--publish")
        client = running.enter_context(StereoClient())
        threading.Thread(target=follow, args=(client, sums), daemon=True).start()
        demo.communicate(timeout=2 * SECONDS)
        used_s = sum(psutil.Process(bridge.pid).cpu_times()[:2])
        listener.wait(STARTING_S + SECONDS)
        bridge.send_signal(signal.SIGINT)
        said, _ = bridge.communicate(timeout=20)
        heard.seek(0)
        images = [line.split()[1:] for line in heard if line.startswith("image ")]
    sent = int(said.split("sent: left/image_raw ")[1].split(",")[0])
    core, step_ms = used_s / SECONDS, reference_step_ms(50)
    print(f"{reliability}: {len(images)} of {sent} images, {core:.1%} of a core, literal step {step_ms:.1f} ms")
    assert sent >= 0.97 * len(sums) > 50 * SECONDS  # of what the daemon sent
    assert "refused: none" in said
    assert len(images) >= 0.99 * sent
    compared = [int(sum_) == sums[seconds, rest] for seconds, rest, *_, sum_ in images if (seconds, rest) in sums]
    assert len(compared) > 0.9 * len(images)
    assert all(compared)
    assert {tuple(words) for _, _, *words, _ in images} == {("mono8", "720", "540")}
    assert core <= CORE_SHARE * step_ms / LITERAL_MS
