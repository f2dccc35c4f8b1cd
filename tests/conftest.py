"""What `make test` leaves out, and a fixture for all.

Left out are the longer checks of `make accept` and `make test-kernel`, and tests that need more than a newcomer has.
"""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import hypothesis
import pytest

# Before anything imports numpy: on a busy machine the threads of BLAS wait for each other, and small matrices take
# several times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2

from fake_camera.usb3.run import CAMERAS_VARIABLE

cv2.setNumThreads(1)  # likewise: a second thread for each small image waits more than it works

# The same examples each time, as the profile that hypothesis chooses in CI, but half as many: `make fuzz` tries more.
hypothesis.settings.register_profile("brief", hypothesis.settings.get_profile("ci"), max_examples=50)
hypothesis.settings.register_profile("few", hypothesis.settings.get_profile("brief"), max_examples=10)  # if emulated

LEFT_OUT = [Path(__file__).with_name(name) for name in ("accept", "kernel", "platforms")]
LONGEST = (
    "drivers/aravis/test_on_usb3.py",
    "calibration/test_judge_sweep.py",
    "autoexpose_daemon/page/test_page.py",
    "evaluation/test_rejudge.py",
    "soak/test_soak.py",
    "fake_camera/usb3/test_usb3_aravis.py",
    "fuzz/test_fuzz.py",
    "drivers/aravis/test_camera_contract.py",
    "navigation/test_teach_and_repeat.py",
    "autoexpose_daemon/test_cli.py",
    "calibration/test_solve.py",
    "calibration/test_commands.py",
    "autoexpose_daemon/control/test_snapshot.py",
    "calibration/test_report.py",
    "drivers/host/test_gvcp.py",
    "evaluation/test_race.py",
    "fake_camera/usb3/test_usb3_camera.py",
    "calibration/test_stated_error.py",
    "autoexpose_daemon/service/test_service.py",
    "autoexpose_daemon/control/test_published_in_closed_loop.py",
    "autoexpose_daemon/doctor/test_doctor.py",
    "autoexpose_daemon/control/test_override.py",
    "calibration/test_commands_noise_latency.py",
    "autoexpose_daemon/control/test_flicker.py",
    "calibration/geometry/test_command.py",
    "autoexpose_daemon/recording/test_replay.py",
    "autoexpose_daemon/doctor/test_camera_features.py",
    "calibration/geometry/test_calibrate.py",
    "fake_camera/gige/test_gige_aravis.py",
    "autoexpose_daemon/control/test_two_cameras.py",
    "autoexpose_daemon/client/test_top.py",
    "autoexpose_daemon/page/test_access.py",
    "autoexpose_daemon/publish/test_control.py",
    "calibration/test_drift.py",
)
"""More than six seconds each: one that waits, for cameras or a browser, and one that computes, in turn."""

MARKED_OUT = ("data", "long", "orbslam3")
QUIET_CORES = 0.25
LOOK_S = 1.0
OTHER_TRANSPORT = "gige_only" if CAMERAS_VARIABLE in os.environ else "usb3_only"


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out folders unless they are asked for by name."""
    asked = [Path(argument.split("::")[0]).resolve() for argument in config.args]
    left_out = collection_path in LEFT_OUT and not any(path.is_relative_to(collection_path) for path in asked)
    return True if left_out else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out marks unless they are asked for by -m, and what is of the other transport.

    The longest files come first, for each is one worker's, and none should be left over at the end. For mutmut, which
    waits for the first test that fails, they come last.
    """
    marks = {OTHER_TRANSPORT, *(mark for mark in MARKED_OUT if mark not in config.option.markexpr)}

    def left_out(item: pytest.Item) -> bool:
        return any(mark.name in marks for mark in item.iter_markers())

    order = {Path(__file__).parent / file: index for index, file in enumerate(LONGEST)}
    config.hook.pytest_deselected(items=[item for item in items if left_out(item)])
    items[:] = sorted(
        (item for item in items if not left_out(item)),
        key=lambda item: order.get(item.path, len(order)),
        reverse="MUTANT_UNDER_TEST" in os.environ,
    )


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Fail in a sentence where a program is missing that `make test` has installed; skip what needs a quiet machine."""
    for mark in item.iter_markers("needs"):
        missing = [program for program in mark.args if shutil.which(program) is None]
        if missing:
            pytest.fail(f"{', '.join(missing)}: not installed; `make setup` installs it", pytrace=False)
    for mark in item.iter_markers("quiet"):
        busy = busy_cores()
        if busy > QUIET_CORES:
            pytest.skip(f"THIS MACHINE IS LOADED: {busy:.1f} of {os.cpu_count()} cores are busy. {mark.args[0]}")


def busy_cores() -> float:
    """How many processors the machine keeps busy at present, beside this process, which sleeps meanwhile."""
    before, began_s = _processor_s(), time.monotonic()
    time.sleep(LOOK_S)
    return (_processor_s() - before) / (time.monotonic() - began_s)


def _processor_s() -> float:
    """Seconds that all processors have worked so far, and that others had of them (steal)."""
    fields = Path("/proc/stat").read_text().split(maxsplit=9)[1:9]
    user, nice, system, _idle, _iowait, irq, softirq, steal = map(int, fields)
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")


@pytest.fixture
def brisk(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, what publishing does once a second, or tries again after seconds, comes at once."""
    monkeypatch.setattr("autoexpose_daemon.publish.publisher._TELL_S", 0.05)
    monkeypatch.setattr("autoexpose_daemon.publish.session._RETRY_S", 0.1)
    monkeypatch.setattr("autoexpose_daemon.client.rig_client._REPORT_S", 0.1)
