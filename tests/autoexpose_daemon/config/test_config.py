from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, get_args

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import camera_setup, load_config
from autoexpose_daemon.control import parameters
from autoexpose_daemon.control.parameters import ControlParameters
from documents import bounds
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from tests import REPOSITORY

LEFT = "cameras: {left: {serial: A}}\n"
THREE = "cameras: {a: {serial: S}, b: {serial: T}, c: {serial: U}}\n"
STEREO = {"cameras": {"left": {"serial": "A"}, "right": {"serial": "B"}}}


def load(folder: Path, text: str) -> Config:
    file = folder / "rig.yaml"
    file.write_text(text)
    return load_config(file)


def complaint(folder: Path, text: str) -> str:
    with pytest.raises(ConfigurationError) as caught:
        load(folder, text)
    message = str(caught.value)
    assert str(folder / "rig.yaml") in message
    return message


def test_a_short_file_has_the_documented_defaults(tmp_path: Path) -> None:
    config = load(tmp_path, "cameras: {left: {serial: '1'}, right: {serial: '2'}}")
    limits = config.exposure.limits()
    assert (limits.min_time_us, limits.max_time_us, limits.min_gain_db, limits.max_gain_db) == (20, 7500, 0, 30)
    assert (config.trigger.mode, config.trigger.rate_hz) == ("external", 60)
    assert config.start == ExposureSetting(2000, 0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cameras: {left: {serial: A}}\nexposure: {max_time: 5000}", ["exposure.max_time:", "max_time_us"]),
        ("cameras: {left: {serial: A, respnse: x}}", ["cameras.left.respnse", "cameras.left.response"]),
        ("camera: {}", ["camera: unknown key", "cameras"]),
        ("exposure: {}", ["cameras: is missing"]),
        ("cameras: {left: {serial: A}}\ncontrol: {policy: begin2021}", ["begin2021", "did you mean begin2022"]),
        ("cameras: {left: {serial: A}}\nexposure: {min_time_us: 900, max_time_us: 30}", ["exposure:", "900"]),
        ("cameras: {left: {serial: A}}\nexposure: {max_time_us: 20000}", ["20000", "trigger.rate_hz"]),
        ("cameras: {left: {serial: A}}\nexposure: {max_time_us: .nan}", ["exposure.max_time_us"]),
        ("cameras: {left: {serial: A}}\ncontrol: {start: {exposure_time_us: 9000}}", ["control.start", "9000"]),
        ("cameras: {left: {serial: A}, right: {serial: A}}", ["same camera"]),
        ("cameras: {left: {serial: A}, right: {serial: B}}\ntrigger: {mode: free_run}", ["free_run"]),
        ("cameras:", ["cameras: is empty"]),
        ("cameras: [A, B]", ["cameras: is no section"]),
        ("cameras: {}", ["cameras: names no cameras", "1 to 8"]),
        (
            f"cameras: {{{', '.join(f'c{each}: {{serial: {each}A}}' for each in range(9))}}}",
            ["names 9 cameras", "1 to 8"],
        ),
        ("cameras: {1: {serial: A}}", ["cameras: 1", "put it in quotes"]),
        ("cameras: {on: {serial: A}}", ["cameras: True", "put it in quotes"]),
        ("cameras: {front: {serial: A, respnse: x}}", ["cameras.front.respnse", "cameras.front.response"]),
        *(
            (f"cameras: {{'{name}': {{serial: A}}}}", [f"cameras: '{name}' is no name", "small letters"])
            for name in ("", "Left", "2nd", "_a", "a b", "a/b", "a*", "../a", "gauche\u0301", "consumers", "both")
        ),
        (f"cameras: {{{'x' * 65}: {{serial: A}}}}", ["is no name", "63"]),
        ("cameras: {a: {serial: S}, b: {serial: T}, c: {serial: S}}", ["cameras: a and c are the same camera, S"]),
        (THREE + "pairs: {p: [a, d]}", ["pairs.p", "'d'", "not among cameras"]),
        (THREE + "pairs: {p: [left, right]}", ["pairs.p", "not among cameras"]),
        (THREE + "pairs: {p: [a, a]}", ["pairs.p has a twice"]),
        (THREE + "pairs: {p: [a]}", ["pairs.p.1: is missing"]),
        (THREE + "pairs: {p: [a, b, c]}", ["pairs.p: ", "2 items"]),
        (THREE + "pairs: {p: a}", ["pairs.p: "]),
        (THREE + "control: {roi: {d: {}}}", ["control.roi.d", "cameras.d"]),
        (THREE + "groups: {rear: {}}", ["groups.rear has no camera", "group: rear"]),
        (THREE + "groups: {all: {polcy: x}}", ["groups.all.polcy", "groups.all.policy"]),
        (THREE + "groups: {all: {policy: begin2021}}", ["groups.all.policy", "did you mean begin2022"]),
        (THREE + "groups: {all: }", ["groups.all: is empty"]),
        (THREE + "groups: {all: {exposure: {}}}", ["groups.all.exposure", "min_time_us"]),
        (THREE + "groups: {all: {exposure: {max_time_us: 20000}}}", ["groups.all: exposure.max_time_us 20000"]),
        (THREE + "groups: {all: {exposure: {max_time_us: 9}}}", ["groups.all: exposure time limits 20 to 9 us"]),
        (THREE + "groups: {all: {start: {exposure_time_us: 8000}}}", ["groups.all: control.start 8000"]),
        ("cameras: {a: {serial: S, group: Rear}}", ["cameras.a.group: 'Rear' is no name"]),
        ("cameras: {left: {serial: A}}\ntrigger: {mode: primary}", ["primary needs two cameras"]),
        (LEFT + "trigger: {mode: software, line: Line0}", ["trigger: line has no effect with mode software", "remove"]),
        (LEFT + "trigger: {phase_ms: 3}", ["trigger: phase_ms", "mode external", "remove it", "ptp or software"]),
        (LEFT + "trigger: {mode: ptp, rate_hz: 7.5, phase_ms: 3}", ["trigger: phase_ms", "whole number", "7.5"]),
        (LEFT + "trigger: {mode: software, rate_hz: 30, phase_ms: 34}", ["trigger: phase_ms 34", "33.33 ms"]),
        (LEFT + "trigger: {mode: ptp, phase_ms: -1}", ["trigger.phase_ms", "out of bounds"]),
        (LEFT + "publish: {stamp: ptp}", ["publish.stamp ptp", "trigger.mode external", "trigger.mode: ptp", "middle"]),
        (LEFT + "publish: {ptp_utc_offset_s: 0}", ["publish: ptp_utc_offset_s", "stamp middle", "stamp: ptp"]),
        ("cameras: {left: {serial: 22500001}}", ["cameras.left.serial", "quotes"]),
        ("cameras: {left: {serial: 0012345}}", ["cameras.left.serial: is a number to YAML: put the serial in quotes"]),
        (LEFT + "control:", ["control: is empty: give keys below it, or remove it"]),
        (LEFT + "control: 3", ["control: is no section: give keys below it"]),
        (LEFT + "publish:", ["publish: is empty: give keys below it, {} for all defaults, or remove it"]),
        (LEFT + "control: {bracket: }", ["control.bracket: is empty"]),
        ("cameras: {left: {serial: A}, right: }", ["cameras.right: is empty"]),
        ("x: 2024-13-45", ["YAML"]),
        ("exposure: {max_time_us: 100}\ncameras: {left: {serial: A}}\nexposure: {}", ["'exposure'", "twice", "line 3"]),
        (LEFT + "control: {balance: blurnoise}", ["control.balance", "blur_noise"]),
        (LEFT + "control: {motion: lucas}", ["control.motion", "farneback"]),
        (LEFT + "control: {flicker_hz: 0}", ["control.flicker_hz: 0 is out of bounds: give 10 to 1000 Hz, or auto"]),
        (
            LEFT + "control: {flicker_hz: aut}",
            ["control.flicker_hz: 'aut' is not a frequency: give 10 to 1000 Hz, or auto"],
        ),
        (LEFT + "control: {focal_length_px: 800}", ["control.focal_length_px has no effect without motion.imu: give"]),
        (LEFT + "motion: {imu: {key: imu/data}}", ["motion.imu needs control.focal_length_px", "cameras.left"]),
        (LEFT + "motion: {imu: {max_age_s: 0.1}}", ["motion.imu.key: is missing"]),
        (
            LEFT + "motion: {imu: {key: /imu/data}}",
            ["motion.imu.key: '/imu/data' is not a key expression of zenoh: write"],
        ),
        (
            LEFT + "motion: {imu: {key: a, zenoh: z.json5}}\ncontrol: {focal_length_px: 800}",
            ["motion.imu.zenoh", "z.json5 cannot be read"],
        ),
        (
            LEFT + "control: {roi: {left: {rectangle: []}}}",
            ["control.roi.left.rectangle", "control.roi.left.rectangles"],
        ),
        (LEFT + "control: {roi: {left: {rectangles: [{box: [0, 0, 9]}]}}}", ["control.roi.left.rectangles.0.box"]),
        (LEFT + "control: {roi: {left: {rectangles: [{box: [0, 0, 9, 0]}]}}}", ["control.roi.left.rectangles.0.box.3"]),
        (LEFT + "control: {roi: {left: {rectangles: [{wieght: 1}]}}}", ["rectangles.0.wieght", "rectangles.0.weight"]),
        (LEFT + "control: {roi: {left: {mask: none.png}}}", ["control.roi.left.mask", "none.png", "cannot be read"]),
        (LEFT + "control: {roi: {right: {}}}", ["control.roi.right", "cameras.right"]),
        *(
            (LEFT + f"trigger: {{rate_hz: {rate}}}", ["trigger.rate_hz: ", "is out of bounds: give 0.1 to 1000 Hz"])
            for rate in ("1.0e-9", "1.0e+6", ".nan", ".inf")
        ),
        *(
            (f"cameras: {{left: {{serial: A, offset_stops: {stops}}}}}", ["cameras.left.offset_stops: ", words])
            for stops, words in (("8.5", "give -8 to 8 stops"), (".nan", "give -8 to 8 stops"), ("yes", "not a number"))
        ),
        (LEFT + "trigger: {rate_hz: yes}", ["trigger.rate_hz: true is not a number"]),
        (LEFT + "exposure: {max_gain_db: 7000}", ["exposure.max_gain_db: 7000.0 is out of bounds: give -60 to 100 dB"]),
        (LEFT + "trigger: {line: ''}", ["trigger.line: '' is not a valid name"]),
        (LEFT + 'trigger: {output_line: "Line1\\e[2J"}', ["trigger.output_line: 'Line1\\x1b[2J' is not a valid name"]),
        ('cameras: {left: {serial: "A\\nB"}}', ["cameras.left.serial: 'A\\nB' is not a valid name"]),
        ('cameras: {left: {serial: "\\e[31mA"}}', ["cameras.left.serial: '\\x1b[31mA' is not a valid name"]),
        ("cameras: {left: {serial: '  '}}", ["cameras.left.serial: '  ' is not a valid name", "without blanks around"]),
        (
            "cameras: {left: {serial: left-1a}, right: {serial: LEFT-1A}}",
            ["cameras: left and right differ only in case, left-1a and LEFT-1A", "autoexpose list"],
        ),
        (
            LEFT + "control: {roi: {left: {rectangles: [{box: [0, 0, 9, 9]}, {box: [0, 0, 99, 99], weight: 0}]}}}",
            ["control.roi.left: no pixel counts"],
        ),
        (
            LEFT + "control: {roi: {left: {background_weight: 0.001, rectangles: [{box: [0, 0, 9, 9], weight: 0}]}}}",
            ["control.roi.left: no pixel counts"],
        ),
        (
            "cameras: {left: {serial: A, features: {Width: 640}}}",
            ["cameras.left.features: is not a list: begin each line with a dash"],
        ),
        (
            "cameras: {left: {serial: A, features: [Width: 640, PixelFormat: Mono8]}}",
            ["cameras.left.features: PixelFormat cannot be set here: the daemon drives it: set image.pixel_format"],
        ),
        (
            "image: {binning: 2}\ncameras: {left: {serial: A, features: [Width: 640]}}",
            ["cameras.left.features: Width cannot be set here: image.binning sets it"],
        ),
        ("[1, 2", ["YAML"]),
        ("just words", ["cameras"]),
        (LEFT + "publish: {rig: a/b}", ["publish.rig", "a/b is not a valid name for a rig"]),
        (LEFT + "publish: {lisen: []}", ["publish.lisen", "publish.listen"]),
        (LEFT + "publish: {connect: [router:7447]}", ["publish", "router:7447 is not an endpoint", "tcp/127.0.0.1"]),
        (LEFT + "publish: {zenoh: z.json5, connect: [tcp/r:7447]}", ["publish", "remove connect"]),
        (LEFT + "publish: {ros2_domain: 233}", ["publish.ros2_domain", "232"]),
        (LEFT + "publish: {ros2_domain: yes}", ["publish.ros2_domain", "integer"]),
        (LEFT + "publish: {zenoh: z.json5}", ["publish.zenoh", "z.json5 cannot be read"]),
    ],
)
def test_a_mistake_is_named_with_its_key(tmp_path: Path, text: str, words: list[str]) -> None:
    message = complaint(tmp_path, text)
    for word in words:
        assert word in message


def test_any_cameras_are_in_the_order_of_the_file(tmp_path: Path) -> None:
    config = load(tmp_path, "cameras: {rear: {serial: S}, front: {serial: T}, top_2: {serial: U}}")
    assert list(config.cameras) == ["rear", "front", "top_2"]
    assert (config.primary, config.stereo_pairs) == ("rear", {})
    assert config.cameras_of_groups == {"all": ("rear", "front", "top_2")}
    assert config.of_group("all") is config


def test_left_comes_before_right_and_they_are_a_pair(tmp_path: Path) -> None:
    config = load(tmp_path, "cameras: {right: {serial: S}, rear: {serial: T}, left: {serial: U}}")
    assert list(config.cameras) == ["rear", "left", "right"]
    assert config.stereo_pairs == {"stereo": ("left", "right")}
    assert [config.side_of(name) for name in config.cameras] == ["left", "left", "right"]


def test_pairs_have_the_cameras_that_they_name(tmp_path: Path) -> None:
    config = load(tmp_path, THREE + "pairs: {near: [a, b], far: [a, c]}")
    assert config.stereo_pairs == {"near": ("a", "b"), "far": ("a", "c")}
    assert [config.side_of(name) for name in config.cameras] == ["left", "right", "right"]


def test_the_first_of_many_cameras_triggers_the_others(tmp_path: Path) -> None:
    config = load(tmp_path, THREE + "trigger: {mode: primary, line: Line3, output_line: Line1}")
    assert config.trigger_sources == {"b": "Line3", "c": "Line3"}
    setups = {name: camera_setup(config, name).trigger for name in config.cameras}
    assert [setups[name].mode for name in "abc"] == ["free_run", "external", "external"]
    assert [setups[name].output_line for name in "abc"] == ["Line1", None, None]
    assert load(tmp_path, THREE).trigger_sources == dict.fromkeys("abc", "Line0")


def test_a_group_has_what_it_names_and_the_rest_in_common(tmp_path: Path) -> None:
    text = (
        "cameras: {a: {serial: S}, b: {serial: T, group: rear}, c: {serial: U, group: rear}}\n"
        "exposure: {max_gain_db: 12}\n"
        "control: {roi: {b: {}}}\n"
        "groups: {rear: {policy: fixed, exposure: {max_time_us: 4000}, start: {exposure_time_us: 3000}}}\n"
    )
    config = load(tmp_path, text)
    assert config.cameras_of_groups == {"all": ("a",), "rear": ("b", "c")}
    front, rear = config.of_group("all"), config.of_group("rear")
    assert [list(part.cameras) for part in (front, rear)] == [["a"], ["b", "c"]]
    assert (front.control.policy, rear.control.policy) == ("belief", "fixed")
    assert (front.exposure.max_time_us, rear.exposure.max_time_us) == (7500, 4000)
    assert (front.exposure.max_gain_db, rear.exposure.max_gain_db) == (12, 12)
    assert (front.start, rear.start) == (ExposureSetting(2000, 0), ExposureSetting(3000, 0))
    assert (list(front.control.roi), list(rear.control.roi)) == ([], ["b"])


@pytest.mark.parametrize(
    "text",
    [
        "cameras: {left: {serial: %s}}",
        "cameras: {%s: {serial: A}}",
        LEFT + "groups: {%s: {}}",
        LEFT + "pairs: {p: [left, %s]}",
        "cameras: {left: {serial: A, %s: 1}}",
        "cameras: {left: {serial: A, response: %s}}",
        "cameras: {left: {serial: A, features: [%s: 1]}}",
        "cameras: {left: {serial: A, features: [Width: %s]}}",
        LEFT + "control: {policy: %s}",
        LEFT + "control: {flicker_hz: %s}",
        LEFT + "control: {roi: {left: {mask: %s}}}",
        LEFT + "trigger: {mode: %s}",
        LEFT + "trigger: {rate_hz: %s}",
        LEFT + "publish: {name: %s}",
        LEFT + "%s: 1",
    ],
)
def test_an_error_is_short_whatever_it_is_about(tmp_path: Path, text: str) -> None:
    said = complaint(tmp_path, text % f"'{'x' * 100_000}'").replace(str(tmp_path), "")
    assert all(len(sentence) < 700 for sentence in said.splitlines()), max(map(len, said.splitlines()))


def test_tuning_reaches_the_loop(tmp_path: Path) -> None:
    text = (
        LEFT + "motion: {imu: {key: imu/data}}\n"
        "control: {balance: flicker, flicker_hz: 120, motion: tiles, focal_length_px: 860, metric_delta: 0.06,"
        " metric_lambda: 10, balance_weight: 0.1, balance_offset: 1, mean_target: 0.4}"
    )
    assert load(tmp_path, text).control.parameters() == ControlParameters(
        metric_delta=0.06, metric_lambda=10, balance_weight=0.1, balance_offset=1, mean_target=0.4,
        balance="flicker", flicker_hz=120, motion="tiles", focal_length_px=860,
    )  # fmt: skip
    assert Config.model_validate(STEREO).control.parameters() == ControlParameters()
    found = Config.model_validate(STEREO | {"control": {"flicker_hz": "auto"}})
    assert found.control.parameters() == ControlParameters(flicker_hz=None)


@pytest.mark.parametrize("policy_id", ["fisher-map", "metric-map"])
def test_what_took_the_place_of_removed_names_is_used_and_named(
    policy_id: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    control = load(tmp_path, LEFT + f"control: {{policy: {policy_id}, motion: dis}}").control
    assert (control.policy, control.motion) == ("belief", "tiles")
    by_policy, by_motion = caplog.messages
    assert all(words in by_policy for words in ("control.policy", policy_id, "belief"))
    assert all(words in by_motion for words in ("control.motion", "dis", "tiles"))


_CAMERAS = {name: value for name, value in vars(bounds).items() if isinstance(value, bounds.Range)}
RANGES = {**_CAMERAS, **parameters.RANGES, **parameters.BRACKET_RANGES}


@pytest.mark.parametrize("name", RANGES)
def test_the_page_of_the_configuration_says_what_numbers_may_be(name: str) -> None:
    page = (REPOSITORY / "docs/look-up/configuration.md").read_text()
    assert str(RANGES[name]) in page


def parts(kind: Any) -> Iterator[Any]:
    yield kind
    for part in get_args(kind):
        yield from parts(part)


def keys(model: type[BaseModel], parent: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """The keys of a model and of those below it."""
    for name, field in model.model_fields.items():
        yield parent + name, field
        for kind in parts(field.annotation):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from keys(kind, f"{parent}{name}.")


KEYS = dict(keys(Config))
NUMBERS = {
    key: Annotated[(field.annotation, field, *field.metadata)]
    for key, field in KEYS.items()
    if {float, int} & {*parts(field.annotation)} and not key.endswith(".box")
}
WORDS = sorted({key.rpartition(".")[2] for key in KEYS})


@pytest.mark.parametrize("word", WORDS)
def test_the_page_of_the_configuration_names_every_key(word: str) -> None:
    page = (REPOSITORY / "docs/look-up/configuration.md").read_text()
    assert re.search(rf"\b{word}\b", page)


@pytest.mark.parametrize("key", NUMBERS)
def test_no_number_of_the_configuration_is_without_bounds(key: str) -> None:
    for beyond in (-(10**30), 10**30):
        with pytest.raises(ValidationError, match=r"out of bounds|less than|greater than"):
            TypeAdapter(NUMBERS[key]).validate_python(beyond)


def test_a_configured_start_is_taken_to_the_letter() -> None:
    config = Config.model_validate(STEREO | {"control": {"start": {"exposure_time_us": 300}}})
    assert config.start == ExposureSetting(300.0, 0.0)


@given(st.floats(1.0, 7000.0), st.floats(1.0, 7000.0))
def test_the_start_is_always_within_the_bounds(low: float, high: float) -> None:
    low, high = sorted((low, high))
    config = Config.model_validate(STEREO | {"exposure": {"min_time_us": low, "max_time_us": high, "max_gain_db": 5}})
    assert low <= config.start.exposure_time_us <= high
    assert 0 <= config.start.gain_db <= 5


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.dates()
GARBAGE = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(WORDS) | SCALARS, inner, max_size=4),
    max_leaves=12,
)


def is_config_or_one_sentence_each(file: Path) -> None:
    """A configuration, or a line for each thing that is wrong, which begins with the file's name."""
    try:
        load_config(file)
    except ConfigurationError as error:
        lines = str(error).splitlines()
        assert lines
        assert all(line.startswith(f"{file}: ") for line in lines)


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=200) | st.binary(max_size=200))
@example("&a [*a, *a]")
@example("cameras: &a {left: *a}")
@example("? [1, 2]\n: 3")
@example("cameras: {left: {serial: A}}\nexposure: {max_time_us: 1e999}")
def test_any_text_is_a_configuration_or_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, content: str | bytes
) -> None:
    file = tmp_path_factory.getbasetemp() / "garbage.yaml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode(errors="replace"))
    is_config_or_one_sentence_each(file)


@settings(max_examples=300, deadline=None)
@given(content=st.dictionaries(st.sampled_from(WORDS), GARBAGE, max_size=5), with_camera=st.booleans())
@example({"cameras": {"\x85": None}}, False)
def test_any_keys_and_values_are_a_configuration_or_a_sentence_for_each_mistake(
    tmp_path_factory: pytest.TempPathFactory, content: dict[str, object], with_camera: bool
) -> None:
    file = tmp_path_factory.getbasetemp() / "garbage.yaml"
    camera: dict[str, object] = {"cameras": {"left": {"serial": "A"}}}
    file.write_text(yaml.safe_dump(content | camera if with_camera else content, allow_unicode=False))
    is_config_or_one_sentence_each(file)


def test_nothing_is_published_unless_the_section_is_there(tmp_path: Path) -> None:
    assert load(tmp_path, LEFT).publish is None
    publish = load(tmp_path, LEFT + "publish: {}").publish
    assert publish is not None
    assert (publish.rig, publish.listen, publish.connect) == ("rig", None, ())
    assert publish.ros2_domain is None


def test_an_offset_reaches_its_camera_alone() -> None:
    cameras = {"left": {"serial": "A"}, "right": {"serial": "B", "offset_stops": 2}}
    config = Config.model_validate({"cameras": cameras})
    assert [camera_setup(config, name).offset_stops for name in config.cameras] == [0.0, 2.0]
