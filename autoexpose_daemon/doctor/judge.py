"""From facts to findings: which cameras were found, and what keeps the daemon from each."""

from __future__ import annotations

from collections.abc import Iterator

from autoexpose_daemon.doctor.facts import Facts
from autoexpose_daemon.doctor.finding import Finding
from autoexpose_daemon.doctor.judge_gige import judge_gige
from autoexpose_daemon.doctor.judge_usb import judge_usb
from autoexpose_daemon.doctor.need import Need


def judge(facts: Facts, need: Need) -> list[Finding]:
    """What the facts mean for a daemon with these needs."""
    return [
        *_missing(facts, need),
        *_without_ptp(facts, need),
        *judge_usb(facts.usb, need, facts.serials),
        *judge_gige(facts.gige, need),
    ]


def _without_ptp(facts: Facts, need: Need) -> Iterator[Finding]:
    for camera in facts.usb.cameras if need.ptp else ():
        if need.wants(camera.serial):
            sentence = f"{need.name(camera.serial)} is on USB3 Vision, where there is no PTP"
            yield Finding("ptp", "stops", sentence, "trigger.mode: software   # in the configuration, or a wire")


def _missing(facts: Facts, need: Need) -> Iterator[Finding]:
    there = ", ".join(facts.serials) or "none"
    for side, serial in need.serials.items():
        if serial not in facts.serials:
            yield Finding(
                "camera-missing",
                "stops",
                f"{need.name(serial)} not found; cameras found: {there}",
                f"autoexpose doctor   # after checking power, cable and cameras.{side}.serial",
            )
    if not need.serials and not (facts.usb.cameras or facts.gige.cameras):
        yield Finding(
            "camera-missing",
            "stops",
            "no camera found, neither USB3 Vision nor GigE Vision",
            "autoexpose doctor   # after checking power and cables",
        )
