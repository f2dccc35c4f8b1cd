from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest

from fake_camera.usb3.usb import descriptors
from fake_camera.usb3.usb.descriptors import Identity

IDENTITY = Identity("Autoexpose", "FakeU3V287M", "FAKE-LEFT", "1.0", "bow")
CONFIGURATION, INTERFACE, ENDPOINT, ASSOCIATION, COMPANION, DEVICE_INFO = 0x02, 0x04, 0x05, 0x0B, 0x30, 0x24


def walk(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The descriptors in a configuration by type, each as long as it says."""
    while data:
        length, kind = data[0], data[1]
        assert 2 <= length <= len(data)
        yield kind, data[:length]
        data = data[length:]


def test_the_device_is_a_composite_super_speed_device() -> None:
    device = descriptors.device_descriptor()
    assert device[0] == len(device) == 18
    assert struct.unpack_from("<H", device, 2) == (0x0300,)
    assert tuple(device[4:7]) == (0xEF, 0x02, 0x01)
    assert 1 << device[7] == 512


def test_the_configuration_is_one_function_of_three_interfaces() -> None:
    data = descriptors.configuration_descriptor()
    kinds = [kind for kind, _ in walk(data)]
    endpoint = [ENDPOINT, COMPANION]
    assert kinds == [
        CONFIGURATION,
        ASSOCIATION,
        *(INTERFACE, DEVICE_INFO, *endpoint, *endpoint),
        *(INTERFACE, *endpoint),
        *(INTERFACE, *endpoint),
    ]
    assert struct.unpack_from("<H", data, 2) == (len(data),)
    assert data[4] == kinds.count(INTERFACE) == 3
    interfaces = [item for kind, item in walk(data) if kind == INTERFACE]
    assert [tuple(item[2:9:2]) for item in interfaces] == [(0, 2, 5, 0), (1, 1, 5, 0), (2, 1, 5, 0)]
    assert [tuple(item[5:8]) for item in interfaces] == [(0xEF, 0x05, part) for part in range(3)]
    assert [item[2] for kind, item in walk(data) if kind == ENDPOINT] == [0x81, 0x01, 0x82, 0x83]


def test_the_guid_is_where_clients_look_for_it() -> None:
    (info,) = [item for kind, item in walk(descriptors.configuration_descriptor()) if kind == DEVICE_INFO]
    assert len(info) == 20
    assert text(info[11]) == IDENTITY.guid
    assert [text(index) for index in info[12:15]] == ["Autoexpose", "FakeU3V287M", "Fake"]
    assert text(info[17]) == "FAKE-LEFT"
    assert text(info[18]) == "bow"


def test_guids_have_twelve_digits_and_differ() -> None:
    other = Identity("Autoexpose", "FakeU3V287M", "FAKE-RIGHT", "1.0", "")
    assert len(IDENTITY.guid) == len(other.guid) == 12
    assert int(IDENTITY.guid, 16) != int(other.guid, 16)


def text(index: int) -> str:
    descriptor = descriptors.string_descriptor(IDENTITY, index)
    assert descriptor is not None
    assert (descriptor[0], descriptor[1]) == (len(descriptor), 0x03)
    return descriptor[2:].decode("utf-16-le")


def test_the_device_names_vendor_model_and_serial() -> None:
    device = descriptors.device_descriptor()
    assert [text(index) for index in device[14:17]] == ["Autoexpose", "FakeU3V287M", "FAKE-LEFT"]


@pytest.mark.parametrize("index", [9, 255])
def test_there_are_no_other_strings(index: int) -> None:
    assert descriptors.string_descriptor(IDENTITY, index) is None


def test_the_object_store_tells_super_speed() -> None:
    store = descriptors.object_store_descriptor()
    assert struct.unpack_from("<HB", store, 2) == (len(store), 2)
    capabilities = [item for _, item in walk(store[5:])]
    assert [item[2] for item in capabilities] == [0x02, 0x03]
    assert struct.unpack_from("<H", capabilities[1], 4) == (1 << 3,)
