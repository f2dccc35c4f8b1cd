"""What systemd itself says of our files."""

from __future__ import annotations

import configparser
import subprocess
from pathlib import Path

import pytest

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.messages.sockets import SYSTEM_FOLDER
from drivers.host import NICENESS
from tests import REPOSITORY

FOLDER = REPOSITORY / "systemd"
UNIT = FOLDER / "autoexpose.service"
PAGE = FOLDER / "autoexpose-page.service"
UNITS = pytest.mark.parametrize("unit", [UNIT, PAGE], ids=lambda unit: unit.stem)
WORST_EXPOSURE = 2.0


def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60, check=False)


SYSTEMD = int(run("systemd-analyze", "--version").stdout.split()[1])
of_newer_systemd = pytest.mark.skipif(SYSTEMD < 250, reason=f"systemd {SYSTEMD} cannot be asked without a boot")


@of_newer_systemd
@UNITS
def test_the_unit_is_shut_in(unit: Path) -> None:
    threshold = f"--threshold={10 * WORST_EXPOSURE:.0f}"
    result = run("systemd-analyze", "security", "--offline=true", "--no-pager", threshold, unit)
    assert result.returncode == 0, result.stdout
    assert f"Overall exposure level for {unit.name}" in result.stdout


@of_newer_systemd
def test_an_open_unit_would_not_pass(tmp_path: Path) -> None:
    unit = tmp_path / UNIT.name
    unit.write_text(
        "\n".join(line for line in UNIT.read_text().splitlines() if not line.startswith("SystemCallFilter"))
    )
    threshold = f"--threshold={10 * WORST_EXPOSURE:.0f}"
    assert run("systemd-analyze", "security", "--offline=true", "--no-pager", threshold, unit).returncode != 0


@UNITS
def test_the_unit_is_sound(unit: Path, tmp_path: Path) -> None:
    program = tmp_path / "autoexpose"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    copy = tmp_path / unit.name
    copy.write_text(unit.read_text().replace("/opt/autoexpose/bin/autoexpose", str(program)))
    result = run("systemd-analyze", "verify", "--man=no", copy)
    # In a root that was not booted it does not know this machine's disks.
    said = [line for line in result.stdout.splitlines() if "udev device" not in line]
    assert (result.returncode, said) == (0, [])


@of_newer_systemd
def test_the_user_may_open_cameras() -> None:
    service = service_of(UNIT)
    result = run("systemd-sysusers", "--dry-run", FOLDER / "sysusers.conf")
    assert result.returncode == 0, result.stdout
    user, group = service["User"], service["SupplementaryGroups"]
    assert f"m {user} {group}" in (FOLDER / "sysusers.conf").read_text()
    assert f'GROUP="{group}"' in (FOLDER / "60-usb3-vision.rules").read_text()


def service_of(path: Path) -> configparser.SectionProxy:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(path)
    return unit["Service"]


def test_the_daemons_socket_is_where_clients_look_and_for_the_group_that_the_pages_unit_has() -> None:
    daemon = service_of(UNIT)
    assert Path("/run", daemon["RuntimeDirectory"]) == SYSTEM_FOLDER
    assert (daemon["RuntimeDirectoryMode"], daemon["RuntimeDirectoryPreserve"]) == ("0750", "yes")
    page = service_of(PAGE)
    assert page["SupplementaryGroups"] == daemon["Group"]
    assert "AF_UNIX" in page["RestrictAddressFamilies"]


def test_the_daemon_comes_before_the_page_and_may_keep_its_priority() -> None:
    """Niceness alone counts only within a group of processes, which is why the daemon's group has a weight."""
    daemon, page = map(service_of, (UNIT, PAGE))
    assert int(daemon["Nice"]) == int(daemon["LimitNICE"]) == NICENESS < 0 < int(page["Nice"])
    assert int(daemon["CPUWeight"]) > 100 > int(page["CPUWeight"])


def test_the_configuration_it_comes_with_is_valid() -> None:
    config = load_config(FOLDER / "config.yaml")
    assert list(config.cameras) == ["left", "right"]
    assert config.publish == PublishConfig()  # to this machine only: without it nobody can see how the daemon is


def test_the_page_is_seen_from_this_machine_only() -> None:
    service = service_of(PAGE)
    assert "--host" not in service["ExecStart"]
    assert (service["IPAddressDeny"], service["IPAddressAllow"]) == ("any", "localhost")
    assert service["DynamicUser"] == "yes"
