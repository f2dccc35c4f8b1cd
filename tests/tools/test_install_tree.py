"""What `tools/install-tree` and `tools/make-deb` make, with a program in Python's place that only leaves files.

`tests/accept/test_install.py` installs everything.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests import REPOSITORY
from tools.stage_package import ROOMS

PYTHON = """\
#!/bin/sh
# As python3, as far as it is asked: venv, pip, make_man, compileall.
set -e
case $* in
    *"-m venv"*)
        place=$(realpath --canonicalize-missing --no-symlinks "$4")
        mkdir -p "$place/bin" "$place/lib/python3.11/site-packages/autoexpose_daemon-0.dist-info"
        touch "$place/lib/python3.11/site-packages/autoexpose_daemon-0.dist-info/direct_url.json"
        touch "$place/pyvenv.cfg"
        cp "$0" "$place/bin/python"
        printf '#!%s/bin/python\\n' "$place" >"$place/bin/autoexpose"
        chmod 755 "$place/bin/autoexpose"
        ;;
    *"-m pip"*) [ -z "$NO_NETWORK" ] ;;
    *tools.stage_package*) exec /usr/bin/python3 "$@" ;;
esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """What is installed from, with empty rooms and our python3."""
    checkout = tmp_path / "checkout"
    for folder in ("systemd", "tools"):
        shutil.copytree(REPOSITORY / folder, checkout / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for room in ROOMS:
        (checkout / room).mkdir()
    for file in ("LICENSE", "README.md", "docs/do/page.md", "pyproject.toml", "setup.py"):
        (checkout / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPOSITORY / file, checkout / file)
    python, script = checkout / "python3", checkout / "tools/install-tree"
    python.write_text(PYTHON)
    python.chmod(0o755)
    script.write_text(script.read_text().replace("/usr/bin/python3", str(python)))
    return checkout


def install(checkout: Path, root: str, prefix: str = "usr/local", network: bool = True) -> bool:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return not subprocess.run(
        [checkout / "tools/install-tree", root, prefix],
        cwd=checkout,
        env=environment | {"NO_NETWORK": "" if network else "1"},
        capture_output=True,
        check=False,
    ).returncode


@pytest.mark.parametrize("root", ["{robot}", "{robot}/", "../robot"])
def test_a_tree_that_will_be_moved_starts_its_own_python(checkout: Path, tmp_path: Path, root: str) -> None:
    robot = tmp_path / "robot"
    assert install(checkout, root.format(robot=robot))
    assert (robot / "opt/autoexpose/bin/autoexpose").read_text() == "#!/opt/autoexpose/bin/python\n"


@pytest.mark.parametrize("prefix", ["usr", "usr/local"])
def test_units_and_configuration_say_where_the_documentation_is(checkout: Path, tmp_path: Path, prefix: str) -> None:
    robot = tmp_path / "robot"
    assert install(checkout, str(robot), prefix)
    page = f"/{prefix}/share/doc/autoexpose-daemon/docs/do/page.md"
    assert (robot / page[1:]).is_file()
    (unit,) = robot.rglob("autoexpose-page.service")
    assert f"Documentation=file://{page}\n" in unit.read_text()
    config = (robot / "etc/autoexpose/config.yaml").read_text()
    assert f" /{prefix}/share/doc/autoexpose-daemon/docs/look-up/configuration.md\n" in config


def test_an_installation_that_fails_leaves_the_former_one(checkout: Path, tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    assert install(checkout, str(robot))
    (robot / "opt/autoexpose/former").touch()
    assert not install(checkout, str(robot), network=False)
    assert (robot / "opt/autoexpose/former").exists()
    assert [path.name for path in (robot / "opt").iterdir()] == ["autoexpose"]


def test_what_a_cut_off_installation_has_replaced_is_not_lost(checkout: Path, tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    assert install(checkout, str(robot))
    (robot / "opt/autoexpose").rename(robot / "opt/autoexpose.former")
    (robot / "opt/autoexpose").mkdir()
    assert not install(checkout, str(robot), network=False)
    assert (robot / "opt/autoexpose/bin/autoexpose").exists()
    (robot / "opt/autoexpose.former").mkdir()
    subprocess.run([checkout / "tools/install-tree", "--remove", robot, "usr/local"], check=True)
    assert [*(robot / "opt").iterdir()] == []


def test_the_checkout_stays_as_it_was(checkout: Path, tmp_path: Path) -> None:
    before = {*checkout.rglob("*")}
    assert install(checkout, str(tmp_path / "robot"))
    assert {*checkout.rglob("*")} == before


def test_a_package_is_made_whatever_its_maker_lets_others_read(tmp_path: Path) -> None:
    config = tmp_path / "tree/etc/autoexpose/config.yaml"
    config.parent.mkdir(parents=True)
    config.touch()
    for folder in (tmp_path / "tree", *config.parents[:2]):
        folder.chmod(0o755)
    make_deb = f"umask 077; exec {REPOSITORY}/tools/make-deb {tmp_path}/tree {tmp_path}"
    subprocess.run(["bash", "-c", make_deb], capture_output=True, check=True)
    assert [*tmp_path.glob("autoexpose-daemon_*.deb")]
