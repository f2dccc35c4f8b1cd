"""Keys of messages from anyone."""

from __future__ import annotations

import pytest

from autoexpose_daemon.messages.keys import frame_key, last_but, side_of


@pytest.mark.parametrize(("parts", "name"), [(0, "image"), (1, "left"), (3, "autoexpose"), (4, "")])
def test_a_part_of_a_key_is_counted_from_its_end(parts: int, name: str) -> None:
    assert last_but(frame_key("rig", "left", "image"), parts) == name


@pytest.mark.parametrize("key", ["**", "*/**", "autoexpose/**", "**/response"])
def test_a_key_that_is_sent_to_all_names_no_camera(key: str) -> None:
    assert side_of(key) is None
