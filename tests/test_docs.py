"""What the tables of the code name, the pages for users name as well."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.status.losses import losses
from drivers.pixel_format import PixelFormat
from drivers.triggers.account import LossReason
from fake_camera.device.faults import GIGE, USB3
from tests import REPOSITORY

NAMED: dict[str, Iterable[str]] = {
    "control.md": POLICY_IDS,
    "configuration.md": PixelFormat,
    "fake-camera.md": GIGE,
    "usb3.md": USB3 - GIGE,
}


def page(name: str) -> str:
    return (REPOSITORY / "docs" / name).read_text()


@pytest.mark.parametrize(("file", "name"), [(file, name) for file, names in NAMED.items() for name in sorted(names)])
def test_the_page_names_it(file: str, name: str) -> None:
    assert f"`{name}`" in page(file)


@pytest.mark.parametrize("reason", LossReason)
def test_a_loss_has_its_row_in_the_words_of_the_terminal(reason: LossReason) -> None:
    ((words, _, _),) = losses({reason: 1})
    assert words != reason, "give it words in status/losses.py"
    assert f"| `{reason}` | {words} |" in page("account.md")
