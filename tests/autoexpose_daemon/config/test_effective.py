"""`autoexpose config show`: what is in force, as a file that means the same."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from autoexpose_daemon.config.document import DEFAULT_START, Config
from autoexpose_daemon.config.effective import effective
from autoexpose_daemon.config.load import load_config
from tests.autoexpose_daemon.service.service_process import Within
from tests.command_lines import readmes_rig

PAIR = "cameras: {left: {serial: A}, right: {serial: B}}\n"
FILES = [
    readmes_rig(),
    "cameras: {one: {serial: A}}\ntrigger: {mode: free_run}\nexposure: {max_time_us: 1000}",
    PAIR + "trigger: {mode: software, rate_hz: 10, phase_ms: 20}\ncontrol: {flicker_hz: auto, bracket: {keep: true}}",
    PAIR + "trigger: {mode: ptp}\npublish: {stamp: ptp, listen: [tcp/127.0.0.1:7448]}\ntransport: {plan: true}",
    PAIR + "trigger: {mode: primary}\nmotion: {imu: {key: robot/imu}}\ncontrol: {focal_length_px: 860}",
    "cameras: {a: {serial: A, group: front, features: [{ReverseX: true}]}, b: {serial: B, group: rear}}\n"
    "groups: {rear: {policy: neves2009, exposure: {max_time_us: 4000}, start: {exposure_time_us: 500}}}\n"
    "pairs: {both_of_them: [a, b]}\ncontrol: {roi: {a: {rectangles: [{box: [0, 0, 9, 9]}]}}}\n"
    "image: {pixel_format: BayerRG12p, binning: 2}",
]


@pytest.mark.parametrize("text", FILES)
def test_it_is_a_file_that_means_the_same(text: str, tmp_path: Path) -> None:
    file, shown = tmp_path / "rig.yaml", tmp_path / "shown.yaml"
    file.write_text(text)
    config = load_config(file)
    shown.write_text(yaml.safe_dump(effective(config), sort_keys=False))
    again = load_config(shown)
    assert again.start == config.start
    control = again.control.model_copy(update={"start": config.control.start})
    assert again.model_copy(update={"control": control}) == config
    assert effective(again) == effective(config)


def test_defaults_are_in_it_and_files_by_their_whole_names(tmp_path: Path) -> None:
    zenoh = tmp_path / "zenoh.json5"
    zenoh.write_text("{}")
    file = tmp_path / "rig.yaml"
    file.write_text(PAIR + "publish: {zenoh: zenoh.json5}")
    document = effective(load_config(file))
    assert document.keys() == Config.model_fields.keys()
    assert document["exposure"]["max_time_us"] == 7500
    assert document["control"]["start"]["exposure_time_us"] == DEFAULT_START.exposure_time_us
    assert document["publish"]["zenoh"] == str(zenoh)
    assert "listen" not in document["publish"]


def test_the_command_prints_yaml_or_json(within: Within, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(PAIR)
    _, as_yaml, _ = within("config", "show", str(file))
    _, as_json, _ = within("config", "show", "-c", str(file), "--json")
    assert yaml.safe_load(as_yaml) == json.loads(as_json) == effective(load_config(file))
