"""Features: as people write them, set in their order, and written only where a node holds another value."""

from __future__ import annotations

import re

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.genicam.features import apply_features, changed_from_default, differing, read_inventory, same, set_features
from drivers.genicam.nodes import fixed_selectors, hold, offered, switch
from drivers.setup import (
    CameraSetup,
    FeatureSetting,
    FeatureValue,
    LinkShare,
    TriggerMode,
    TriggerSetup,
    as_list,
    parse_features,
)
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError
from tests.drivers.genicam.node_map import (
    BooleanNode,
    CommandNode,
    EnumerationNode,
    FloatNode,
    IntegerNode,
    MemoryNodes,
    Node,
    StringNode,
)

LINES = ("Line1", "Line2")


class Camera(MemoryNodes):
    """Width and OffsetX share 720 pixels, LineInverter has a value for each line, and a user set can be loaded."""

    def __init__(self) -> None:
        self.inverted = dict.fromkeys(LINES, False)
        super().__init__(
            {
                "Width": IntegerNode(720, 8, 720, "px", 4),
                "OffsetX": IntegerNode(0, 0, 0, "px", 4),
                "LineSelector": EnumerationNode("Line1", LINES, ("LineInverter",)),
                "LineInverter": BooleanNode(),
                "BlackLevel": FloatNode(0.0, 0.0, 12.5, "%"),
                "Sharpness": EnumerationNode("Off", ("Off", "On", "Strong")),
                "SensorWidth": IntegerNode(720, locked=True),
                "DeviceUserID": StringNode(""),
                "Gain": FloatNode(0.0, 0.0, 40.0, "dB"),
                "GevPersistentIPAddress": IntegerNode(0),
                "UserSetSelector": EnumerationNode("Default", ("Default",), ("UserSetLoad",)),
                "UserSetLoad": CommandNode(self._load),
            }
        )

    def read(self, name: str) -> FeatureValue:
        return self.inverted[str(self.read("LineSelector"))] if name == "LineInverter" else super().read(name)

    def write(self, name: str, value: FeatureValue) -> None:
        super().write(name, value)
        if name == "LineInverter":
            self.inverted[str(self.read("LineSelector"))] = bool(value)
        width, offset = self._node("Width", IntegerNode), self._node("OffsetX", IntegerNode)
        for node, other in ((width, offset), (offset, width)):
            node.value -= node.value % node.increment
            node.high = 720 - other.value

    def _load(self) -> None:
        self.writes.append(("UserSetLoad", True))
        self._node("BlackLevel", FloatNode).value = 0.0
        for name, value in (("OffsetX", 0), ("Width", 720)):
            self.write(name, value)
        self.inverted = dict.fromkeys(LINES, False)


def features(text: str) -> tuple[FeatureSetting, ...]:
    return parse_features(yaml.safe_load(text))


def setup(text: str, mode: TriggerMode = "external", **more: object) -> CameraSetup:
    return CameraSetup(TriggerSetup(mode), features=features(text), **more)  # type: ignore[arg-type]


def test_they_are_set_in_their_order_and_selectors_put_back() -> None:
    camera = Camera()
    apply_features(
        camera,
        setup(
            "- UserSetSelector: Default\n- UserSetLoad: execute\n- Width: 320\n- OffsetX: 400\n"
            "- LineSelector[Line2].LineInverter: on\n- BlackLevel: 2\n- Sharpness: On\n- DeviceUserID: left"
        ),
    )
    assert (camera.read("Width"), camera.read("OffsetX")) == (320, 400)
    assert camera.inverted == {"Line1": False, "Line2": True}
    assert camera.read("LineSelector") == "Line1"
    names = [name for name, _ in camera.writes]
    assert names.index("UserSetLoad") < names.index("BlackLevel") < names.index("Sharpness")


def test_a_region_may_move_and_grow_whatever_it_was() -> None:
    camera = Camera()
    for width, offset in ((320, 400), (700, 20), (8, 712), (720, 0)):
        assert set_features(camera, features(f"- Width: {width}\n- OffsetX: {offset}")) == []
        assert (camera.read("Width"), camera.read("OffsetX")) == (width, offset)


def test_what_another_feature_changes_is_set_again() -> None:
    class Binning(Camera):
        def write(self, name: str, value: FeatureValue) -> None:
            super().write(name, value)
            if name == "BlackLevel":
                self.write("OffsetX", 0)

    camera = Binning()
    assert set_features(camera, features("- Width: 320\n- OffsetX: 400\n- BlackLevel: 2")) == []
    assert camera.read("OffsetX") == 400


def test_what_cannot_be_before_a_command_is_not_tried_after_it() -> None:
    camera = Camera()
    set_features(camera, features("- Width: 320\n- OffsetX: 400"))
    (trouble,) = set_features(camera, features("- Width: 720\n- UserSetSelector: Default\n- UserSetLoad: execute"))
    assert str(trouble).startswith("Width: it takes 8 to 320 px in steps of 4")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Widht: 640", "Widht: the camera has no such feature; did you mean Width?"),
        ("Zzz: 640", "Zzz: the camera has no such feature"),
        ("Width: 1000", "Width: it takes 8 to 720 px in steps of 4 at present, not 1000"),
        ("Width: 322", "Width: set to 322, it reads back 320: it takes 8 to 720 px in steps of 4"),
        ("Width: 320.5", "Width: it takes a whole number, not 320.5"),
        ("BlackLevel: '3'", "BlackLevel: it takes a number, not '3'"),
        ("BlackLevel: 13.5", "BlackLevel: it takes 0 to 12.5 % at present, not 13.5"),
        ("LineInverter: 1", "LineInverter: it takes true or false, not 1"),
        ("Sharpness: strong", "Sharpness: it takes Off, On, Strong, not strong; did you mean Strong?"),
        ("DeviceUserID: 22", "DeviceUserID: it takes text, in quotes, not 22"),
        ("UserSetLoad: true", "UserSetLoad: it takes only `execute`, being a command, not True"),
        ("SensorWidth: 8", "SensorWidth: it is read-only, or locked at present by another feature"),
        ("LineSelector[Line3].LineInverter: true", "its selector LineSelector: it takes Line1, Line2, not Line3"),
        ("LinSelector[Line1].LineInverter: true", "the camera has no such feature; did you mean LineSelector?"),
        ("BlackLevel[1].LineInverter: true", "its selector BlackLevel: it takes a number, not '1'"),
    ],
)
def test_what_a_camera_does_not_take_is_named_with_the_reason(text: str, words: str) -> None:
    with pytest.raises(ConfigurationError) as refusal:
        apply_features(Camera(), setup(f"- {text}"))
    assert str(refusal.value).startswith("camera M1: features: ")
    assert words in str(refusal.value)


def test_all_that_is_wrong_is_told_at_once() -> None:
    camera = Camera()
    camera.nodes["BlackLevel"] = FloatNode(2.0, 0.0, 12.5, "%", locked=True)  # it may be asked for as it is
    with pytest.raises(ConfigurationError, match=r"features: Widht: .*; Heigth: .*; BlackLevel: it is read-only"):
        apply_features(camera, setup("- Widht: 640\n- Heigth: 480\n- BlackLevel: 3"))
    assert set_features(camera, features("- BlackLevel: 2")) == []


def test_a_refusal_without_a_reason_may_pass() -> None:
    class Refusing(Camera):
        def write(self, name: str, value: FeatureValue) -> None:
            raise NodeError(f"camera M1: could not set {name}: access denied")

    with pytest.raises(NodeError, match=r"features: DeviceUserID: .*access denied"):
        apply_features(Refusing(), setup("- DeviceUserID: left"))


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("ExposureTime: 100", "exposure.max_time_us"),
        ("GainAuto: Off", "exposure.max_gain_db"),
        ("Gain: 3", "exposure.max_gain_db"),
        ("GainSelector[All].GainRaw: 3", "exposure.max_gain_db"),
        ("TriggerMode: On", "trigger.mode"),
        ("TriggerSelector[LineStart].TriggerMode: On", "trigger.mode"),
        ("TriggerActivation: FallingEdge", "LineInverter"),
        ("PixelFormat: Mono8", "image.pixel_format"),
        ("GevSCPSPacketSize: 1500", "transport.packet_size_bytes"),
        ("ChunkSelector[Gain].ChunkEnable: false", "remove it"),
        ("UserSetSave: execute", "wear out"),
    ],
)
def test_what_the_daemon_drives_is_refused_with_its_own_key(text: str, key: str) -> None:
    camera = Camera()
    with pytest.raises(ConfigurationError, match=f"{key}"):
        apply_features(camera, setup(f"- {text}\n- BlackLevel: 2"))
    assert camera.writes == []


def test_what_is_driven_depends_on_the_setup_and_on_the_camera() -> None:
    camera = Camera()
    camera.nodes["Gain"] = FloatNode(0.0, 0.0, 40.0)  # no dB: not driven
    apply_features(camera, setup("- Gain: 3"))
    apply_features(camera, setup("- Width: 320"))
    with pytest.raises(ConfigurationError, match=r"Width cannot be set here: image\.binning"):
        apply_features(camera, setup("- Width: 320", binning=2))
    with pytest.raises(ConfigurationError, match=r"transport\.plan sets it"):
        apply_features(camera, setup("- GevSCPD: 1000", link_share=LinkShare(2)))
    with pytest.raises(ConfigurationError, match=r"trigger\.rate_hz"):
        apply_features(camera, setup("- AcquisitionFrameRate: 20", "free_run"))
    source = features("- LineSelector[Line2].LineSource: Off")
    primary = CameraSetup(TriggerSetup("free_run", output_line="Line2"), features=source)
    with pytest.raises(ConfigurationError, match=r"trigger\.output_line"):
        apply_features(camera, primary)


def test_the_inventory_can_be_set_again() -> None:
    camera = Camera()
    set_features(camera, features("- Width: 320\n- OffsetX: 400\n- LineSelector[Line2].LineInverter: true"))
    inventory = read_inventory(camera)
    assert [setting.key for setting in inventory.settings] == [
        *("Width", "OffsetX", "LineSelector[Line1].LineInverter", "LineSelector[Line2].LineInverter", "BlackLevel"),
        *("Sharpness", "DeviceUserID", "Gain"),
    ]
    other = Camera()
    assert {setting.name for setting, _ in differing(other, inventory.settings)} == {"Width", "OffsetX", "LineInverter"}
    assert set_features(other, inventory.settings) == []
    assert differing(other, inventory.settings) == []


def test_what_differs_from_the_default_user_set_is_found_and_put_back() -> None:
    camera = Camera()
    set_features(camera, features("- Width: 320\n- OffsetX: 400\n- LineSelector[Line2].LineInverter: true"))
    before = read_inventory(camera).settings
    changed, lost = changed_from_default(camera, before)
    assert [setting.key for setting in changed] == ["Width", "OffsetX", "LineSelector[Line2].LineInverter"]
    assert lost == []
    assert read_inventory(camera).settings == before
    with pytest.raises(UnsupportedCameraError, match="--diff FILE"):
        changed_from_default(MemoryNodes({"Width": IntegerNode(8)}), [])
    assert same(30, 30.0000003) and same(False, "Off")
    assert not same(30, 31.0) and not same(False, "On")


def test_of_a_read_only_selector_only_the_entry_at_which_it_stands_is_offered() -> None:
    camera = Camera()
    camera.nodes["LineSelector"] = EnumerationNode("Line1", LINES, ("LineInverter",), locked=True)
    assert set_features(camera, features("- LineSelector[Line1].LineInverter: true")) == []
    (trouble,) = set_features(camera, features("- LineSelector[Line2].LineInverter: true"))
    assert str(trouble).endswith("its selector LineSelector: it is read-only and stands at Line1")
    keys = [setting.key for setting in read_inventory(camera).settings]
    assert "LineSelector[Line1].LineInverter" in keys
    assert "LineSelector[Line2].LineInverter" not in keys


LOCKED = EnumerationNode("All", ("All", "Tap1"), locked=True)


@pytest.mark.parametrize(
    ("node", "present", "other"),
    [
        (FloatNode(5.0), 5.0, 6.0),
        (IntegerNode(5), 5, 6),
        (BooleanNode(True), True, False),
        (EnumerationNode("Off", ("Off", "On")), "Off", "On"),
        (StringNode("left"), "left", "right"),
    ],
)
def test_only_another_value_is_written(node: Node, present: FeatureValue, other: FeatureValue) -> None:
    nodes = MemoryNodes({"Feature": node})
    hold(nodes, "Feature", present)
    assert nodes.writes == []
    hold(nodes, "Feature", other)
    assert nodes.writes == [("Feature", other)]


@pytest.mark.parametrize(
    ("node", "off", "on"),
    [
        (EnumerationNode("Continuous", ("Off", "Once", "On")), "Off", "On"),
        (EnumerationNode("Yes", ("No", "Yes")), "No", "Yes"),
        (BooleanNode(True), False, True),
        (IntegerNode(1), 0, 1),
    ],
)
def test_a_switch_may_be_of_three_kinds(node: Node, off: FeatureValue, on: FeatureValue) -> None:
    nodes = MemoryNodes({"GainAuto": node})
    switch(nodes, "GainAuto", False)
    switch(nodes, "GainAuto", True)
    assert nodes.writes == [("GainAuto", off), ("GainAuto", on)]


def test_what_cannot_be_had_is_refused_by_name_with_what_there_is() -> None:
    with pytest.raises(NodeError, match="M1: its GainAuto has no Off, only Once, Continuous"):
        switch(MemoryNodes({"GainAuto": EnumerationNode("Once", ("Once", "Continuous"))}), "GainAuto", False)
    with pytest.raises(NodeError, match="M1: it has no ChunkEnable"):
        switch(MemoryNodes({}), "ChunkEnable", True)
    nodes = MemoryNodes({"GainSelector": LOCKED})
    hold(nodes, "GainSelector", "All")
    with pytest.raises(NodeError, match="M1: its GainSelector is All and cannot be Tap1"):
        hold(nodes, "GainSelector", "Tap1")
    assert nodes.writes == []


def test_a_read_only_selector_offers_only_the_entry_at_which_it_stands() -> None:
    nodes = MemoryNodes({"GainSelector": LOCKED, "LineSelector": EnumerationNode("Line1", ("Line0", "Line1"))})
    assert [offered(nodes, name) for name in ("GainSelector", "LineSelector", "TriggerSelector")] == [
        ("All",), ("Line0", "Line1"), ()
    ]  # fmt: skip
    (fixed,) = fixed_selectors(nodes)
    assert "GainSelector" in fixed and "stays at All" in fixed and fixed.endswith("Tap1")


NAMES = st.from_regex(r"[A-Za-z_]\w{0,20}", fullmatch=True)
ENTRIES = st.from_regex(r"[^\[\]\s\x00-\x1f]{1,12}", fullmatch=True).filter(str.isprintable)
NUMBERS = st.integers(-(1 << 63), (1 << 64) - 1) | st.floats(-1e18, 1e18)
VALUES = st.booleans() | NUMBERS | st.text(max_size=40).filter(str.isprintable)
SETTINGS = st.builds(FeatureSetting, NAMES, VALUES, st.lists(st.tuples(NAMES, ENTRIES), max_size=2).map(tuple))


@settings(max_examples=30, deadline=None)
@given(st.lists(SETTINGS, max_size=5).map(tuple))
def test_what_is_written_is_read(written: tuple[FeatureSetting, ...]) -> None:
    assert parse_features(yaml.safe_load(yaml.safe_dump(as_list(written), allow_unicode=True))) == written


def test_it_is_written_as_in_the_docs() -> None:
    (feature,) = parse_features(yaml.safe_load("- LineSelector[Line2].LineInverter: true"))
    assert feature == FeatureSetting("LineInverter", True, (("LineSelector", "Line2"),))
    assert feature.key == "LineSelector[Line2].LineInverter"
    assert (feature.entry("LineSelector"), feature.entry("GainSelector")) == ("Line2", None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Width: 640", "is not a list: begin each line with a dash"),
        ("- Width", "item 1 is not one `- Name: value`"),
        ("- Width: 640\n- Height: 4\n  OffsetX: 8", "item 2 is not one"),
        ("- 'Line[].LineInverter': 640", "is not a feature"),
        ("- UserSetLoad:", "UserSetLoad is set to None: give a number, true, false, or text in quotes"),
        ("- DeviceUserID: 2026-01-01", "in quotes"),
        ("- Gamma: .nan", "Gamma is set to nan: give a number of at most 64 bits"),
        ("- Width: 99999999999999999999999", "give a number of at most 64 bits"),
        ('- DeviceUserID: "a\\nb"', "printable"),
    ],
)
def test_a_mistake_is_named_with_its_place(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        parse_features(yaml.safe_load(text))
