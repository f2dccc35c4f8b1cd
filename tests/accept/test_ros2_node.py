"""The ROS 2 node beside a demo, as a program of ROS 2 meets it; `make test-ros2` visits it for longer."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.accept.ros2_node import RATE_HZ, Visit, build

SECONDS = 20.0

pytestmark = [pytest.mark.needs("cmake", "g++"), pytest.mark.timeout(400)]


def test_a_foreign_program_finds_all_that_a_camera_driver_offers(tmp_path: Path) -> None:
    build()
    visit = Visit(SECONDS, tmp_path)
    assert [line for line in visit.said if line.startswith("missing: ")] == []
    assert not visit.failed
    same, sent, different = visit.compare()
    print(f"{same} of {sent} images, {visit.core_share:.1%} of a core")
    assert same == sent > SECONDS * RATE_HZ
    assert different == 0
