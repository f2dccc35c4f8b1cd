"""Two cameras behind a switch whose memory holds a third of a frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.triggers.outcomes import LossReason
from tests.autoexpose_daemon.stereo import ON_USB, running_daemon, stereo_cameras

MBPS, KIB = 500, 128
RATE_HZ = 20.0
TRIGGERS = 100

pytestmark = [pytest.mark.realtime, pytest.mark.skipif(ON_USB, reason="switches are for GigE Vision")]


@pytest.mark.parametrize("plan", [False, True])
def test_a_switch_drops_packets_unless_cameras_keep_to_their_share(tmp_path: Path, plan: bool) -> None:
    settings = {
        "trigger": {"rate_hz": RATE_HZ},
        "control": {"policy": "fixed"},
        "transport": {"plan": True, "link_mbps": MBPS} if plan else {},
    }
    switch = f"{tmp_path / 'switch'},{MBPS},{KIB}"
    with (
        stereo_cameras("--still", "--line0-rate-hz", str(RATE_HZ), "--switch", switch) as cameras,
        running_daemon(cameras, settings) as run,
    ):
        lost, counts = run.daemon.tally.lost, run.daemon.telemetry.counts
        run.wait_until(lambda: sum(lost.values()) + counts.pairs > TRIGGERS, "triggers")
        incomplete = lost[LossReason.INCOMPLETE]
    print(f"plan {plan}: {incomplete} pairs incomplete beside {counts.pairs}")
    assert incomplete == 0 if plan else incomplete > TRIGGERS / 50  # fewer collide if this machine is slow to send
