"""The image of `make image`: unpacked by umoci and started by runc, which know nothing of how it was made."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests import REPOSITORY
from tests.accept.commands import output

pytestmark = [
    pytest.mark.timeout(1800),
    pytest.mark.needs("runc", "umoci"),
    pytest.mark.skipif(os.geteuid() != 0, reason="making a root file system and starting a container need root"),
]


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The image as a container runtime wants it."""
    output("make", "image")
    (file,) = (REPOSITORY / "build/image").glob("autoexpose-*.tar")
    folder = tmp_path_factory.mktemp("image")
    output("tar", "-xf", file, folder=folder)
    version = file.name.split("-")[1]
    output("umoci", "unpack", "--image", f".:{version}", "bundle", folder=folder)
    return folder / "bundle"


def run(bundle: Path, *arguments: str) -> str:
    """What the image's program prints, in the network of this machine."""
    config = json.loads((bundle / "config.json").read_text())
    config["process"] |= {"args": ["autoexpose", *arguments], "terminal": False}
    config["linux"]["namespaces"] = [one for one in config["linux"]["namespaces"] if one["type"] != "network"]
    (bundle / "config.json").write_text(json.dumps(config))
    return output("runc", "run", f"autoexpose-{os.getpid()}", folder=bundle)


def test_its_first_command_is_the_doctor(bundle: Path) -> None:
    assert json.loads((bundle / "config.json").read_text())["process"]["args"] == ["autoexpose", "doctor"]


def test_it_says_its_version(bundle: Path) -> None:
    assert run(bundle, "--version").startswith("autoexpose ")


def test_the_demo_runs(bundle: Path) -> None:
    run(bundle, "demo", "--seconds", "5", "--summary", "/tmp/out.json")
    assert json.loads((bundle / "rootfs/tmp/out.json").read_text())["pairs"] > 0


def test_nothing_of_this_machine_is_in_it(bundle: Path) -> None:
    root = bundle / "rootfs"
    assert (root / "etc/resolv.conf").read_text() == ""
    assert not [name for name in ("etc/hostname", "etc/pip.conf", "wheel", "src") if (root / name).exists()]
