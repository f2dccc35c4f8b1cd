"""What frames are: their pixels by format, and the setting that they were taken with."""

from __future__ import annotations

import contextlib
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.image_format import (
    MOST_PADDING_BYTES,
    choose_pixel_format,
    decode_pixels,
    frame_size,
    send_low_byte_first,
    set_binning,
    switch_white_balance_off,
)
from drivers.genicam.metadata import ChunkNodes, SettingLedger, WriteLatency, enable_chunks
from drivers.setup import FeatureValue
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError
from imaging.exposure import ExposureSetting
from imaging.pixels import PixelFormat
from tests.drivers.genicam.node_map import BooleanNode, EnumerationNode, FloatNode, IntegerNode, MemoryNodes, Node


def colour_camera(present: str) -> MemoryNodes:
    return MemoryNodes({"PixelFormat": EnumerationNode(present, ("BayerRG8", "Mono8", "YUV422Packed", "RGB8Packed"))})


def test_a_pixel_format_is_set_or_kept() -> None:
    nodes = colour_camera("BayerRG8")
    assert choose_pixel_format(nodes, PixelFormat.MONO8) == "Mono8"
    assert nodes.writes == [("PixelFormat", "Mono8")]
    assert choose_pixel_format(nodes, None) == "Mono8"
    assert len(nodes.writes) == 1


def test_a_former_name_of_a_format_will_do() -> None:
    nodes = colour_camera("RGB8Packed")
    assert choose_pixel_format(nodes, None) == "RGB8"
    assert choose_pixel_format(nodes, PixelFormat.RGB8) == "RGB8"
    assert nodes.writes == []
    assert choose_pixel_format(nodes, PixelFormat.MONO8) == "Mono8"
    assert choose_pixel_format(nodes, PixelFormat.RGB8) == "RGB8"
    assert nodes.writes[-1] == ("PixelFormat", "RGB8Packed")


def test_other_formats_are_refused_by_name() -> None:
    with pytest.raises(UnsupportedCameraError, match=r"M1: .*YUV422Packed .*BayerRG8 or Mono8 or RGB8Packed"):
        choose_pixel_format(colour_camera("YUV422Packed"), None)
    with pytest.raises(ConfigurationError, match="no pixel format Mono16; it has BayerRG8, Mono8"):
        choose_pixel_format(colour_camera("Mono8"), PixelFormat.MONO16)
    lone = MemoryNodes({"PixelFormat": EnumerationNode("YUV422Packed", ("YUV422Packed",))})
    with pytest.raises(UnsupportedCameraError, match="it has no other that is"):
        choose_pixel_format(lone, None)


def test_automatic_white_balance_is_switched_off_and_said_so_where_there_are_colours(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    nodes = MemoryNodes({"BalanceWhiteAuto": EnumerationNode("Continuous", ("Off", "Once", "Continuous"))})
    switch_white_balance_off(nodes, PixelFormat.MONO8)
    assert nodes.writes == []
    for _ in range(2):
        switch_white_balance_off(nodes, PixelFormat.BAYER_RG8)
    assert nodes.writes == [("BalanceWhiteAuto", "Off")]
    assert len(caplog.messages) == 1 and "M1: BalanceWhiteAuto was Continuous, now Off" in caplog.messages[0]
    switch_white_balance_off(MemoryNodes({}), PixelFormat.RGB8)


def test_before_a_format_is_chosen_the_present_one_says_whether_there_are_colours() -> None:
    for present, written in (("BayerRG8", ["BalanceWhiteAuto"]), ("Mono8", []), ("YUV411Packed", [])):
        nodes = colour_camera(present)
        nodes.nodes["BalanceWhiteAuto"] = EnumerationNode("Continuous", ("Off", "Continuous"))
        switch_white_balance_off(nodes, None)
        assert [name for name, _ in nodes.writes] == written
    switch_white_balance_off(MemoryNodes({}), None)


def test_the_size_of_frames_is_what_the_camera_says_if_it_does() -> None:
    nodes = {"Width": IntegerNode(720), "Height": IntegerNode(540)}
    assert frame_size(MemoryNodes(nodes)) == (720, 540)
    assert frame_size(MemoryNodes({"Width": IntegerNode(720)})) is None


def test_binning_resets_the_region_to_the_whole_sensor() -> None:
    nodes = MemoryNodes(
        {
            "BinningHorizontal": IntegerNode(1, 1, 4),
            "BinningVertical": IntegerNode(1, 1, 4),
            "OffsetX": IntegerNode(8),
            "OffsetY": IntegerNode(4),
            "Width": IntegerNode(100, 8, 360),
            "Height": IntegerNode(100, 4, 270),
        }
    )
    set_binning(nodes, None)
    assert nodes.writes == []
    set_binning(nodes, 2)
    assert {name: nodes.read(name) for name in nodes.nodes} == {
        "BinningHorizontal": 2, "BinningVertical": 2, "OffsetX": 0, "OffsetY": 0, "Width": 360, "Height": 270
    }  # fmt: skip
    with pytest.raises(ConfigurationError, match="BinningHorizontal takes 1 to 4 at present, not 8"):
        set_binning(nodes, 8)
    with pytest.raises(ConfigurationError, match="cannot bin pixels"):
        set_binning(MemoryNodes({}), 2)


def any_image(pixel_format: PixelFormat, width: int, height: int, seed: int = 1) -> bytes:
    """Random bytes, within the bits of a sample of two."""
    data = np.frombuffer(np.random.default_rng(seed).bytes(pixel_format.image_bytes(width, height)), np.uint8).copy()
    if pixel_format.bits_per_pixel == 16 and pixel_format.bit_depth > 8:
        data[1::2] &= (1 << pixel_format.bit_depth - 8) - 1
    return data.tobytes()


@given(st.sampled_from(PixelFormat), st.integers(1, 8), st.integers(1, 8), st.binary(max_size=40), st.integers(0, 99))
def test_decoding_leaves_chunks_and_filling_alone(
    expected: PixelFormat, half_width: int, height: int, chunks: bytes, seed: int
) -> None:
    width = 2 * half_width
    image = any_image(expected, width, height, seed)
    alone = decode_pixels(image, expected.pfnc_code, width, height, expected)
    followed = decode_pixels(image + chunks, expected.pfnc_code, width, height, expected, has_chunks=True)
    filled = decode_pixels(image + bytes(4 * seed), expected.pfnc_code, width, height, expected)
    assert alone.shape[:2] == (height, width)
    assert np.array_equal(alone, followed) and np.array_equal(alone, filled)


MONO8, YUV = PixelFormat.MONO8, PixelFormat.YUV422_8


@pytest.mark.parametrize(
    ("size", "code", "expected", "padding_bytes", "words"),
    [
        *(((width, height), MONO8.pfnc_code, MONO8, 0, f"an image of {width}x{height} pixels")
          for width, height in ((0, 2), (3, 0), (-3, -2), (-3, 2))),
        ((3, 2), YUV.pfnc_code, YUV, 0, "an image of 3x2 pixels in YUV422_8"),
        ((6, 2), MONO8.pfnc_code, MONO8, 2, "rows with 2 bytes of padding"),
        ((3, 2), 0x0108000A, PixelFormat.BAYER_RG8, 0, "BayerGB8, but the camera was set to BayerRG8"),
        ((3, 2), 0x0210001F, PixelFormat.BAYER_RG8, 0, "unknown pixel format 0x0210001f"),
    ],
)  # fmt: skip
def test_a_frame_that_says_something_else_is_refused_by_name(
    size: tuple[int, int], code: int, expected: PixelFormat, padding_bytes: int, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        decode_pixels(bytes(12), code, *size, expected, row_padding_bytes=padding_bytes)


@given(
    st.sampled_from(PixelFormat),
    st.integers(1, 8),
    st.integers(1, 8),
    st.integers(-300, 300) | st.integers(MOST_PADDING_BYTES - 1, MOST_PADDING_BYTES + 2),
)
def test_a_wrong_number_of_bytes_is_refused(expected: PixelFormat, half_width: int, height: int, more: int) -> None:
    needed = expected.image_bytes(2 * half_width, height)
    data = bytes(max(needed + more, 0))
    for has_chunks in (False, True):
        fits = more >= 0 and (has_chunks or more <= MOST_PADDING_BYTES)
        with contextlib.nullcontext() if fits else pytest.raises(ValueError, match=f"bytes for an image of {needed}"):
            decode_pixels(data, expected.pfnc_code, 2 * half_width, height, expected, has_chunks=has_chunks)


@pytest.mark.parametrize("name", ["GevSCPSBigEndian", "PixelBigEndian", "pgrPixelBigEndian"])
def test_samples_of_two_bytes_are_asked_for_with_the_low_one_first(name: str) -> None:
    nodes = MemoryNodes({name: BooleanNode(True)})
    for pixel_format in (PixelFormat.MONO8, PixelFormat.MONO12P, PixelFormat.MONO12_PACKED, PixelFormat.RGB8):
        send_low_byte_first(nodes, pixel_format)
    assert nodes.writes == []
    for _ in range(2):  # it is not written where it holds already
        send_low_byte_first(nodes, PixelFormat.MONO16)
    assert nodes.writes == [(name, False)]


def test_a_camera_that_keeps_sending_the_high_byte_first_is_refused() -> None:
    class Stubborn(MemoryNodes):
        def write(self, name: str, value: FeatureValue) -> None:
            pass

    class Refusing(MemoryNodes):
        def write(self, name: str, value: FeatureValue) -> None:
            raise NodeError("it is read-only")

    for kind, why in ((Stubborn, "stays on"), (Refusing, "cannot be switched off .it is read-only")):
        with pytest.raises(UnsupportedCameraError, match=f"high byte of Mono12 first, as GevSCPSBigEndian .*{why}"):
            send_low_byte_first(kind({"GevSCPSBigEndian": BooleanNode(True)}), PixelFormat.MONO12)


def picture(bit_depth: int, level: float, noise: float) -> np.ndarray:  # type: ignore[type-arg]
    """A gradient with a step, full scale being 1."""
    numbers = np.random.default_rng(3)
    ramp = np.linspace(0.6, 1.4, 160) * np.where(np.arange(120) < 60, 1.0, 0.4)[:, None]
    full = (1 << bit_depth) - 1
    return np.clip(full * (level * ramp + noise * numbers.standard_normal((120, 160))), 0, full).astype(np.uint16)


@pytest.mark.parametrize("pixel_format", [PixelFormat.MONO10, PixelFormat.MONO12, PixelFormat.MONO16])
@pytest.mark.parametrize("level", [0.05, 0.3, 0.9])
def test_pictures_with_the_high_byte_first_are_refused_by_name(pixel_format: PixelFormat, level: float) -> None:
    pixels = picture(pixel_format.bit_depth, level, 0.01)
    sent, code = pixels.astype("<u2").tobytes(), pixel_format.pfnc_code
    assert np.array_equal(decode_pixels(sent, code, 160, 120, pixel_format), pixels)
    with pytest.raises(ValueError, match="only with their high byte first, or go beyond"):
        decode_pixels(pixels.astype(">u2").tobytes(), code, 160, 120, pixel_format)


@pytest.mark.parametrize("level", [0.0, 0.3, 5.0], ids=["black", "grey", "white"])
@pytest.mark.parametrize("low_bits", [0, 4, 8])
@pytest.mark.parametrize("noise", [0.0, 0.001, 0.05])
def test_sound_pictures_of_16_bits_are_read(level: float, low_bits: int, noise: float) -> None:
    """Of fewer bits, shifted to the left, too."""
    pixels = picture(16, level, noise) >> low_bits << low_bits
    sent = pixels.astype("<u2").tobytes()
    assert np.array_equal(decode_pixels(sent, PixelFormat.MONO16.pfnc_code, 160, 120, PixelFormat.MONO16), pixels)


@given(st.integers(0, 1 << 32), st.integers(1, 40), st.integers(1, 40))
def test_noise_is_no_order_of_bytes(seed: int, width: int, height: int) -> None:
    pixels = np.random.default_rng(seed).integers(0, 1 << 16, (height, 4 * width), np.uint16)
    code = PixelFormat.MONO16.pfnc_code
    assert np.array_equal(
        decode_pixels(pixels.astype("<u2").tobytes(), code, 4 * width, height, PixelFormat.MONO16), pixels
    )


PERIOD_NS = 16_666_667


def test_the_ledger_gives_the_setting_last_written_before_the_frame() -> None:
    first, second, third = (ExposureSetting(1000.0 * number, 0.0) for number in range(1, 4))
    ledger = SettingLedger(first)
    ledger.record(100, second)
    ledger.record(200, third)
    assert [ledger.setting_at(time) for time in (99, 100, 199, 200, 900)] == [first, second, second, third, third]
    for time in range(201, 400):
        ledger.record(time, ExposureSetting(float(time), 0.0))
    assert ledger.setting_at(399).exposure_time_us == 399
    assert 201 < ledger.setting_at(1).exposure_time_us < 399  # the oldest are forgotten


def test_the_ledger_follows_the_latency_that_brightness_shows() -> None:
    """A camera that shows a write 25 ms later, written between frames 10 ms apart."""
    ledger = SettingLedger(ExposureSetting(1000.0, 0.0))
    written_ns, times_us = 0, [1000.0, 4000.0]
    for start_ns in range(0, 400_000_000, 10_000_000):
        if start_ns in (100_000_000, 250_000_000):
            written_ns = start_ns + 1_000_000 - 10_000_000
            times_us.reverse()
            ledger.record(written_ns, ExposureSetting(times_us[0], 0.0))
        shown_us = times_us[0] if start_ns >= written_ns + 25_000_000 or not written_ns else times_us[1]
        ledger.observe(start_ns, shown_us / 40)
        if start_ns >= 250_000_000:
            assert ledger.setting_at(start_ns).exposure_time_us == shown_us


def latency_ns(shown_after_ns: int, changes_stops: list[float], light: float = 0.0) -> int:
    """As found for a camera that shows a write so much later; a change every 12 frames, at random phases."""
    numbers, measured = random.Random(1), WriteLatency()
    level, shown, due_ns = 5.0, 5.0, 0
    for frame in range(12 * (len(changes_stops) + 1)):
        start_ns = frame * PERIOD_NS
        if frame and frame % 12 == 0:
            written_ns = start_ns - numbers.randrange(1, PERIOD_NS)
            change = changes_stops[frame // 12 - 1]
            level += change
            due_ns = written_ns + shown_after_ns
            measured.write(written_ns, change)
        shown = level if start_ns > due_ns else shown
        measured.frame(start_ns, 2.0 ** (shown + light * numbers.uniform(-1, 1)))
    return measured.latency_ns


@pytest.mark.parametrize("periods", [0, 1, 2])
def test_it_finds_the_delay_of_a_camera_in_whole_frames(periods: int) -> None:
    found_ns = latency_ns(periods * PERIOD_NS, [1.0, -1.0] * 4, light=0.05)
    assert (periods - 0.4) * PERIOD_NS < found_ns <= periods * PERIOD_NS


def test_the_latency_is_zero_until_a_change_was_seen_with_frames_to_itself() -> None:
    assert latency_ns(2 * PERIOD_NS, [0.2, -0.2]) == 0
    measured, level = WriteLatency(), 5.0
    for frame in range(60):
        measured.frame(frame * PERIOD_NS, 2.0**level)
        level += 1.0 if frame % 2 else -1.0
        measured.write(frame * PERIOD_NS + 1, 1.0 if frame % 2 else -1.0)
    assert measured.latency_ns == 0


def with_chunks(*entries: str, unit: str | None = None, locked: bool = False, **others: Node) -> MemoryNodes:
    nodes: dict[str, Node] = {
        "ChunkModeActive": BooleanNode(locked, locked),
        "ChunkSelector": EnumerationNode(entries[-1], entries, locked=locked),
        "ChunkEnable": BooleanNode(locked, locked),
        "ChunkExposureTime": FloatNode(0.0, unit=unit),
    }
    return MemoryNodes(nodes | others)


@pytest.mark.parametrize(("gain_node", "chunk"), [("Gain", "Gain"), ("GainRaw", "GainAll"), (None, None)])
def test_chunks_are_switched_on(gain_node: str | None, chunk: str | None) -> None:
    nodes = with_chunks(
        "ExposureTime", "Gain", "GainAll", "Image", ChunkGain=FloatNode(0.0), ChunkGainAll=IntegerNode(0)
    )
    wanted = ChunkNodes("ChunkExposureTime", 1.0, chunk and f"Chunk{chunk}", gain_node == "GainRaw")
    assert enable_chunks(nodes, gain_node) == (wanted, ())
    chosen = [entry for name, entry in nodes.writes if name == "ChunkSelector"]
    assert chosen == ["ExposureTime", *([] if chunk is None else [chunk])]
    assert nodes.writes[0] == ("ChunkModeActive", True)


@pytest.mark.parametrize(
    ("nodes", "us_per_unit"),
    [(with_chunks("ExposureTime", unit="s"), 1e6), (with_chunks("Image", "ExposureTime", locked=True), 1.0)],
    ids=["in seconds", "on already"],
)
def test_the_time_is_read_in_microseconds_and_what_is_on_already_needs_no_write(
    nodes: MemoryNodes, us_per_unit: float
) -> None:
    assert enable_chunks(nodes, None) == (ChunkNodes("ChunkExposureTime", us_per_unit, None), ())


def test_missing_chunks_are_reported() -> None:
    for nodes in (with_chunks("ExposureTime", "Image"), with_chunks("ExposureTime", "Image", ChunkGain=FloatNode(0.0))):
        chunks, (limitation,) = enable_chunks(nodes, "Gain")
        assert chunks is None
        assert "no chunk data of ExposureTime and Gain" in limitation and "inferred" in limitation
        assert nodes.writes[-1] == ("ChunkModeActive", False)
    without_its_node = with_chunks("ExposureTime")
    del without_its_node.nodes["ChunkExposureTime"]
    for nodes in (without_its_node, with_chunks("ExposureTime", unit="lines"), MemoryNodes({})):
        assert enable_chunks(nodes, None)[0] is None


def test_chunks_that_cannot_be_switched_on_are_reported_with_the_reason() -> None:
    class Refusing(MemoryNodes):
        def write(self, name: str, value: FeatureValue) -> None:
            raise NodeError(f"could not set {name}: write-protect")

    chunks, (limitation,) = enable_chunks(Refusing(with_chunks("Image").nodes), None)
    assert chunks is None
    assert "inferred" in limitation and "could not set ChunkModeActive: write-protect" in limitation
