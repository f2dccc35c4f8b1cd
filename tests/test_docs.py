"""What the tables of the code name, the pages for users name as well."""

from __future__ import annotations

import re
from collections.abc import Iterable

import pytest

from autoexpose_daemon.cli.listing import LISTINGS
from autoexpose_daemon.control.loop import STATE_FORMAT
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.recording.read import FORMER_FORMATS
from autoexpose_daemon.status.panel import losses
from calibration import gain
from calibration.response import file as response
from calibration.vignetting import file as vignetting
from drivers.triggers.outcomes import LossReason
from fake_camera.device.faults import GIGE, USB3
from imaging.pixels import PixelFormat
from navigation.store import rows
from tests import REPOSITORY

NAMED: dict[str, Iterable[str]] = {
    "understand/control.md": POLICY_IDS,
    "look-up/configuration.md": PixelFormat,
    "do/fake-camera.md": GIGE,
    "do/usb3.md": USB3 - GIGE,
}


def page(name: str) -> str:
    return (REPOSITORY / "docs" / name).read_text()


@pytest.mark.parametrize(("file", "name"), [(file, name) for file, names in NAMED.items() for name in sorted(names)])
def test_the_page_names_it(file: str, name: str) -> None:
    assert f"`{name}`" in page(file)


PATHS = re.findall(
    r"`((?:autoexpose_daemon|benchmarks|calibration|docs|drivers|evaluation|fake_camera|tests)/[\w/.]*)`",
    (REPOSITORY / "CONTRIBUTING.md").read_text(),
)


@pytest.mark.parametrize("path", sorted(set(PATHS)))
def test_what_contributors_are_sent_to_is_there(path: str) -> None:
    assert (REPOSITORY / path).exists()


@pytest.mark.parametrize("command", LISTINGS)
def test_some_page_shows_how_to_call_it(command: str) -> None:
    pages = [REPOSITORY / "README.md", *(REPOSITORY / "docs").rglob("*.md")]
    assert any(f"autoexpose {command}" in file.read_text() for file in pages)


@pytest.mark.parametrize("reason", LossReason)
def test_a_loss_has_its_row_in_the_words_of_the_terminal(reason: LossReason) -> None:
    ((words, _, _),) = losses({reason: 1})
    assert words != reason, "give it words in status/panel.py"
    assert f"| `{reason}` | {words} |" in page("understand/account.md")


def test_the_formats_that_are_promised_are_read() -> None:
    text = page("look-up/stability.md")
    name, _, latest = STATE_FORMAT.partition("/")
    assert tuple(f"{name}/{number}" for number in range(2, int(latest))) == FORMER_FORMATS
    for promised in (f"`{name}/2` to `/{latest}`", *(f"`{each.FORMAT}`" for each in (gain, response, vignetting))):
        assert promised in text
    assert f"format {rows.FORMAT} is read" in text
