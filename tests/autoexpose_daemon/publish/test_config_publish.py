from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import load_config
from autoexpose_daemon.messages.keys import LOOPBACK
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.service import add_outlets
from imaging.errors import ConfigurationError

LEFT = "cameras: {left: {serial: A}}\n"


def load(folder: Path, publish: str) -> Config:
    file = folder / "rig.yaml"
    file.write_text(f"{LEFT}{publish}")
    return load_config(file)


def test_nothing_is_published_unless_the_section_is_there(tmp_path: Path) -> None:
    assert load(tmp_path, "").publish is None
    publish = load(tmp_path, "publish: {}").publish
    assert publish is not None
    assert (publish.rig, publish.listen, publish.connect) == ("rig", (LOOPBACK,), ())
    assert publish.ros2_domain is None


@pytest.mark.parametrize(
    ("publish", "words"),
    [
        ("publish: {rig: a/b}", ["publish.rig", "a/b is not a valid name for a rig"]),
        ("publish: {lisen: []}", ["publish.lisen", "did you mean publish.listen"]),
        ("publish: {connect: [router:7447]}", ["publish", "router:7447 is not an endpoint", "tcp/127.0.0.1"]),
        ("publish: {zenoh: z.json5, connect: [tcp/r:7447]}", ["publish", "remove connect"]),
        ("publish: {ros2_domain: 233}", ["publish.ros2_domain", "232"]),
        ("publish: {ros2_domain: yes}", ["publish.ros2_domain", "integer"]),
        ("publish: {zenoh: z.json5}", ["publish.zenoh", "z.json5 cannot be read (No such file"]),
    ],
)
def test_what_cannot_be_is_named(tmp_path: Path, publish: str, words: list[str]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, publish)
    for word in ["rig.yaml", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (np.random.default_rng(0).bytes(500), "UTF-8"),
        (b"{mode: 'peer'", "line 1"),
        (b"{mode: 'pear'}", "pear"),
        (b"{endpoint: 'tcp/1.2.3.4:7447'}", "endpoint"),
        (b"", "mpty"),
        (b"[" * 200_000, "nests"),
    ],
)
def test_a_file_that_zenoh_cannot_use_is_refused_at_once(tmp_path: Path, content: bytes, word: str) -> None:
    """It was called valid, and then tried again for ever."""
    (tmp_path / "z.json5").write_bytes(content)
    imu = "motion: {imu: {key: imu/data, zenoh: z.json5}}\ncontrol: {focal_length_px: 800}"
    for section in ("publish: {zenoh: z.json5}", imu):
        with pytest.raises(ConfigurationError, match=r"z\.json5 is not a configuration of zenoh") as caught:
            load(tmp_path, section)
        assert word in str(caught.value)
        assert len(str(caught.value)) < 500 and "\n" not in str(caught.value)


def test_a_file_of_zenohs_is_named_from_the_configuration(tmp_path: Path) -> None:
    (tmp_path / "z.json5").write_text("{}")
    publish = load(tmp_path, "publish: {zenoh: z.json5}").publish
    assert publish is not None
    assert publish.zenoh == tmp_path / "z.json5"


def test_without_zenoh_the_daemon_goes_on_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    really_import = builtins.__import__

    def without_zenoh(name: str, *rest: Any) -> Any:
        if name in ("autoexpose_daemon.publish.publisher", "autoexpose_daemon.publish.inbound"):
            raise ModuleNotFoundError("No module named 'zenoh'", name="zenoh")
        return really_import(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_zenoh)
    config = load(tmp_path, "publish: {}\nmotion: {imu: {key: imu/data}}\ncontrol: {focal_length_px: 800}")
    daemon = add_outlets(Daemon(config, {}), config)
    assert daemon.outlets == []
    assert daemon.telemetry.publishing is not None
    assert "zenoh is missing" in daemon.telemetry.publishing.trouble
    assert "autoexpose-daemon[publish]" in caplog.text
    assert daemon._control.sources["angular_rate_rad_s"](0) is None
    assert daemon.telemetry.imu is not None
    assert "zenoh is missing" in daemon.telemetry.imu.trouble
