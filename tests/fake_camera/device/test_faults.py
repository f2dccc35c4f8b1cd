"""Faults: orders as JSON lines, how they count, and the socket they come through."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from fake_camera.device.control_socket import ControlSocket
from fake_camera.device.faults import MOST_ORDERS, PER_TRIGGER, USB3, Fault, FaultError, FaultOrder, Faults


def met(faults: Faults, fault: Fault, triggers: range) -> list[int]:
    return [trigger for trigger in triggers if fault in faults.on_trigger(trigger)]


@pytest.mark.parametrize(
    ("line", "order"),
    [
        ('{"fault": "freeze"}', FaultOrder(Fault.FREEZE, None, 1)),
        ('{"fault": "lose_packets", "after_trigger": 7, "count": 3}', FaultOrder(Fault.LOSE_PACKETS, 7, 3)),
        ('{"fault": "vanish", "after_trigger": null, "count": null}', FaultOrder(Fault.VANISH, None, None)),
        ('{"fault": "come_back"}', FaultOrder(Fault.COME_BACK, None, 1)),
    ],
)
def test_reads_an_order(line: str, order: FaultOrder) -> None:
    assert FaultOrder.from_json(line) == order


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("", "not JSON"),
        ("[]", "JSON object"),
        ('{"fault": "explode"}', "unknown fault 'explode'"),
        ('{"count": 1}', "unknown fault None"),
        ('{"fault": "freeze", "after": 1}', "unknown key 'after'"),
        ('{"fault": "freeze", "count": 0}', "count must be"),
        ('{"fault": "freeze", "count": true}', "count must be"),
        ('{"fault": "freeze", "count": 1e3}', "count must be"),
        ('{"fault": "freeze", "count": 1%s}' % ("0" * 4000), r"count must be .*, not 1000.*\.\.\..*000$"),
        ('{"fault": "freeze", "count": 1%s}' % ("0" * 9000), "not JSON|count must be"),  # by the Python
        ('{"fault": "%s"}' % ("x" * 3000), r"unknown fault 'xxx.*\.\.\..*xxx'"),
        ('{"%s": 1}' % ("x" * 3000), r"unknown key 'xxx.*\.\.\..*xxx'"),
        ('{"fault": "freeze", "after_trigger": 1.5}', "after_trigger must be"),
        ('{"fault": "come_back", "count": 2}', "no count"),
    ],
)
def test_refuses_what_is_no_order(line: str, complaint: str) -> None:
    with pytest.raises(FaultError, match=complaint):
        FaultOrder.from_json(line)


@pytest.mark.parametrize("fault", sorted(PER_TRIGGER - {Fault.VANISH}))
def test_counts_triggers_after_the_one_named(fault: Fault) -> None:
    faults = Faults()
    faults.add(FaultOrder(fault, after_trigger=4, count=3))
    assert met(faults, fault, range(12)) == [5, 6, 7]
    assert faults.add(FaultOrder(fault, count=2)) == 11
    assert met(faults, fault, range(12, 20)) == [12, 13]


def test_vanishes_for_a_count_and_restarts_once_before_it_answers() -> None:
    calls: list[tuple[str, bool]] = []
    faults = Faults(lambda: calls.append(("on", faults.vanished)), lambda: calls.append(("off", faults.vanished)))
    faults.add(FaultOrder(Fault.VANISH, after_trigger=2, count=2))
    gone = []
    for trigger in range(7):
        if trigger == 4:  # another order does not end an absence
            faults.add(FaultOrder(Fault.FREEZE, after_trigger=50))
        faults.on_trigger(trigger)
        gone.append(faults.vanished)
    assert gone == [False, False, False, True, True, False, False]
    assert [name for name, _ in calls] == ["off", "on"]
    assert calls[1] == ("on", True)


def test_stays_away_until_called_back() -> None:
    restarts = []
    faults = Faults(lambda: restarts.append(1))
    faults.add(FaultOrder(Fault.VANISH, count=None))
    assert faults.vanished
    assert met(faults, Fault.VANISH, range(100)) == list(range(100))
    faults.add(FaultOrder(Fault.COME_BACK, after_trigger=101))
    faults.on_trigger(101)
    assert faults.vanished
    assert faults.on_trigger(102) == frozenset()
    assert not faults.vanished
    assert len(restarts) == 1


def test_whoever_orders_it_back_finds_it_back() -> None:
    restarting, finish, back = threading.Event(), threading.Event(), threading.Event()

    def power_on() -> None:
        restarting.set()
        assert finish.wait(5)

    def order() -> None:
        faults.add(FaultOrder(Fault.COME_BACK))
        assert not faults.vanished
        back.set()

    faults = Faults(power_on)
    faults.add(FaultOrder(Fault.VANISH, count=1))
    faults.on_trigger(0)
    threads = [threading.Thread(target=faults.on_trigger, args=(1,)), threading.Thread(target=order)]
    threads[0].start()
    assert restarting.wait(5)
    threads[1].start()
    assert not back.is_set()
    finish.set()
    assert back.wait(5)
    for thread in threads:
        thread.join()


def test_a_transport_knows_only_its_own_faults() -> None:
    faults = Faults()
    faults.restrict(USB3)
    with pytest.raises(FaultError, match=r"^this camera cannot have the fault lose_packets: its faults are "):
        faults.add(FaultOrder(Fault.LOSE_PACKETS))
    faults.add(FaultOrder(Fault.STALL, after_trigger=1))
    spoilt = []
    for trigger in range(4):
        faults.on_trigger(trigger)
        faults.on_send(trigger)
        spoilt.append(faults.spoils_frame(Fault.STALL))
    assert spoilt == [False, False, True, False]


def test_loses_packets_from_the_frame_of_the_trigger_on() -> None:
    faults = Faults()
    faults.add(FaultOrder(Fault.LOSE_PACKETS, after_trigger=1, count=3))
    lost = []
    for trigger in range(4):
        faults.on_trigger(trigger)
        faults.on_send(trigger)
        lost += [(trigger, packet) for packet in range(2) if faults.lose_packet()]
    assert lost == [(2, 0), (2, 1), (3, 0)]
    faults.add(FaultOrder(Fault.LOSE_PACKETS, after_trigger=3, count=1))
    faults.on_trigger(4)
    faults.on_send(3)  # a frame of before, though the trigger has passed
    assert not faults.lose_packet()


@pytest.fixture
def control(tmp_path: Path) -> Iterator[tuple[Path, Faults]]:
    faults = Faults()
    control = ControlSocket(tmp_path / "control", faults)
    yield tmp_path / "control", faults
    control.close()


def ask(path: Path, *lines: str) -> list[dict[str, object]]:
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5)
        client.connect(str(path))
        client.sendall("".join(line + "\n" for line in lines).encode())
        client.shutdown(socket.SHUT_WR)
        with client.makefile() as answers:
            return [json.loads(answer) for answer in answers]


def test_each_line_is_acknowledged(control: tuple[Path, Faults]) -> None:
    path, faults = control
    faults.on_trigger(8)
    answers = ask(path, '{"fault": "freeze", "after_trigger": 10, "count": 2}', "nonsense", '{"fault": "vanish"}')
    assert answers[0] == {"ok": True, "fault": "freeze", "after_trigger": 10, "count": 2, "last_trigger": 8}
    assert answers[1]["ok"] is False
    assert "not JSON" in str(answers[1]["error"])
    assert answers[2]["ok"] is True
    assert faults.vanished
    with socket.socket(socket.AF_UNIX) as client:  # beside another connection, and no text
        client.settimeout(5)
        client.connect(str(path))
        assert ask(path, '{"fault": "delay"}')[0]["ok"] is True
        client.sendall(b"\xff\xfe\n")
        assert json.loads(client.recv(4096))["ok"] is False


def test_a_huge_line_is_answered_once_and_the_next_as_ever(control: tuple[Path, Faults]) -> None:
    path, _ = control
    answers = ask(path, "[" * 3_000_000, '{"fault": "delay"}', "x" * 4095, '{"fault": "delay"}' + " " * 4096)
    assert [answer["ok"] for answer in answers] == [False, True, False, False]
    assert "longer than 4096 bytes" in str(answers[0]["error"])
    assert "not JSON" in str(answers[2]["error"])
    assert max(len(str(answer)) for answer in answers) < 300


def test_orders_do_not_pile_up_without_end(control: tuple[Path, Faults]) -> None:
    path, faults = control
    late = '{"fault": "freeze", "after_trigger": 1000}'
    answers = ask(path, '{"fault": "vanish"}', *[late] * MOST_ORDERS, '{"fault": "come_back"}', late)
    assert [answer["ok"] for answer in answers] == [True] * MOST_ORDERS + [False, True, True]
    assert f"{MOST_ORDERS} orders" in str(answers[MOST_ORDERS]["error"])
    assert not faults.vanished


def test_replaces_a_dead_socket_file_but_neither_a_live_one_nor_another_file(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(OSError, match="in use"):
        ControlSocket(notes, Faults())
    assert notes.read_text() == "mine"
    path = tmp_path / "control"
    dead = socket.socket(socket.AF_UNIX)
    dead.bind(str(path))
    dead.close()
    control = ControlSocket(path, Faults())
    with pytest.raises(OSError, match="in use"):
        ControlSocket(path, Faults())
    assert ask(path, '{"fault": "delay"}')[0]["ok"] is True
    control.close()
    assert not path.exists()
