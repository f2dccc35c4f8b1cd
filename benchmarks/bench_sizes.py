"""How many stereo pairs a second two fake cameras, Aravis and the daemon hold without loss, by sensor and transport.

A still scene under steady light. Each rate is tried for some seconds, a second time if that fails, in a process of its
own (`sizes_trial.py`): by a receiver that only takes frames from the driver, then by the daemon, which also decides,
writes and accounts. What the receiver alone does not hold is beyond the fake cameras, Aravis or this machine; what the
daemon holds less is its own.

Run with `.venv/bin/python benchmarks/bench_sizes.py [--quick] [--pixel-format NAME] [--json OUT.json]`: about ten
minutes on two cores; with --quick, smallest and largest sensor only, about three.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from autoexpose_daemon.demo.options import SIZES, Transport
from autoexpose_daemon.demo.reference_step import reference_step_ms
from autoexpose_daemon.demo.show import cores
from drivers.host.network import bytes_per_s, needed_bytes_per_s
from drivers.host.usb import USB3_MBPS, usb_bytes_per_s
from imaging.pixels import PIXEL_FORMATS, PixelFormat

TRIAL = Path(__file__).with_name("sizes_trial.py")
TRIAL_TIMEOUT_S = 90
NAMES: dict[Transport, str] = {"gige": "GigE", "usb3": "USB3"}
GIGE_MBPS = 1000
PACKET_BYTES = 9000
"""Jumbo frames, the largest that the fake cameras send."""
LOWEST_HZ, HIGHEST_HZ = 1.0, 300.0
"""The fake sensors are read out in 3 ms, whatever their size, which ends at 333 frames a second."""

Who = Literal["alone", "daemon"]


@dataclass(frozen=True, slots=True)
class Trial:
    """What `sizes_trial.py` says of one trial; `decided` and `decision_ms` of the daemon only."""

    rate_hz: float
    pairs_per_s: float
    lost: int
    cameras_late: int
    receiver_ms: float
    cameras_ms: float
    decided: float | None = None
    decision_ms: float | None = None

    @property
    def held(self) -> bool:
        """Whether nothing was lost, and as much came as was asked for."""
        return not self.lost and self.pairs_per_s > 0.9 * self.rate_hz


@dataclass(frozen=True, slots=True)
class Cell:
    """Two cameras of a sensor size on a transport."""

    transport: Transport
    size: str
    pixel_format: PixelFormat

    @property
    def link_limit_hz(self) -> float:
        """Pairs a second that a real link would carry."""
        width, height = map(int, self.size.split("x"))
        image_bytes = self.pixel_format.image_bytes(width, height)
        if self.transport == "usb3":
            return usb_bytes_per_s(USB3_MBPS, 2) / image_bytes
        return bytes_per_s(GIGE_MBPS, 2) / needed_bytes_per_s(image_bytes, PACKET_BYTES, 1.0)


@dataclass(frozen=True, slots=True)
class Row:
    """The most that was held, and why no more; None: not even `LOWEST_HZ`."""

    cell: Cell
    alone: Trial | None
    daemon: Trial | None
    ended_by: str


def attempt(who: Who, cell: Cell, rate_hz: float, seconds: float) -> Trial:
    """Try one rate; SystemExit with one sentence when the trial itself fails."""
    command = [sys.executable, str(TRIAL), who, cell.transport, cell.size, cell.pixel_format.value]
    command += [f"{rate_hz:.6g}", f"{seconds:g}"]
    with tempfile.TemporaryDirectory() as folder:
        if cell.transport == "usb3":
            sockets = [f"{folder}/{camera}" for camera in ("left", "right")]
            command = [sys.executable, "-m", "fake_camera.usb3", *sockets, "--", *command]
        run = subprocess.run(command, capture_output=True, text=True, timeout=TRIAL_TIMEOUT_S, check=False)
    try:
        return Trial(rate_hz, **json.loads(run.stdout.splitlines()[-1]))
    except (IndexError, ValueError, TypeError):
        said = run.stderr.strip().splitlines() or ["it printed nothing"]
        raise SystemExit(f"bench_sizes: a trial failed ({' '.join(command)}): {said[-1]}") from None


def highest_held(
    trial: Callable[[float], Trial], start_hz: float, refinements: int
) -> tuple[Trial | None, Trial | None]:
    """The highest rate held and the lowest that was not: up or down by twos from a start, then between."""
    held, failed = None, None
    rate_hz = min(max(start_hz, LOWEST_HZ), HIGHEST_HZ)
    while refinements:
        result = trial(rate_hz)
        if result.held:
            held = result
        else:
            failed = result
        low, high = held and held.rate_hz, failed and failed.rate_hz
        if low and high:
            refinements -= 1
            rate_hz = statistics.geometric_mean([low, high])
        elif (low or LOWEST_HZ) >= HIGHEST_HZ or (high or HIGHEST_HZ) <= LOWEST_HZ:
            break
        else:
            rate_hz = min(2 * low, HIGHEST_HZ) if low else max(rate_hz / 2, LOWEST_HZ)
    return held, failed


def why(alone: Trial | None, failed: Trial | None, daemon: Trial | None) -> str:
    """What the daemon's next rate failed by."""
    if failed is None:
        return "the sensor's readout"
    if failed.cameras_late:
        return "no processor time left for the fakes"
    if alone is not None and daemon is not None and daemon.rate_hz >= 0.8 * alone.rate_hz:
        return "the fakes or Aravis"
    return "the daemon"


def measure(cells: Sequence[Cell], seconds: float, fine: int) -> list[Row]:
    """All rows, with progress on stderr."""
    rows = []
    for cell in cells:
        found: dict[Who, tuple[Trial | None, Trial | None]] = {}
        start_hz = min(cell.link_limit_hz / 2, 40.0)
        for who in get_args(Who):

            def trial(rate_hz: float, who: Who = who, cell: Cell = cell) -> Trial:
                result = attempt(who, cell, rate_hz, seconds)
                if not result.held:  # once may be another program's doing
                    result = attempt(who, cell, rate_hz, seconds)
                said = "held" if result.held else f"{result.pairs_per_s:.1f} pairs/s, {result.lost} lost"
                where = f"{NAMES[cell.transport]} {cell.size}, {who}"
                print(f"  {where}: {rate_hz:.1f} Hz: {said}", file=sys.stderr, flush=True)
                return result

            held, failed = found[who] = highest_held(trial, start_hz, fine)
            start_hz = held.rate_hz if held is not None else LOWEST_HZ
        alone, daemon = found["alone"][0], found["daemon"][0]
        rows.append(Row(cell, alone, daemon, why(alone, failed, daemon)))
    return rows


def table(rows: list[Row], literal_ms: float) -> str:
    """The rows as a Markdown table; times are in literal steps."""
    heads = (
        "sensor", "transport", "link carries", "receiver alone", "daemon", "daemon / link", "daemon / alone",
        "pairs decided on", "work: both cameras", "receiver alone", "daemon", "processor allows", "no more, because of",
    )  # fmt: skip
    lines = [" | ".join(heads), "|".join(["---"] * len(heads))]
    for row in rows:
        alone, daemon = row.alone, row.daemon
        rates = [None if trial is None else trial.rate_hz for trial in (alone, daemon)]
        work_ms = [
            None if daemon is None else daemon.cameras_ms,
            None if alone is None else alone.receiver_ms,
            None if daemon is None else daemon.receiver_ms,
        ]
        cells = [
            row.cell.size,
            NAMES[row.cell.transport],
            f"{row.cell.link_limit_hz:.1f}",
            *("-" if rate is None else f"{rate:.1f}" for rate in rates),
            "-" if daemon is None else f"{daemon.rate_hz / row.cell.link_limit_hz:.2f}",
            "-" if daemon is None or alone is None else f"{daemon.rate_hz / alone.rate_hz:.2f}",
            "-" if daemon is None or daemon.decided is None else f"{daemon.decided:.0%}",
            *("-" if each is None else f"{each / literal_ms:.1f}" for each in work_ms),
            "-" if daemon is None else f"{1e3 * cores() / (daemon.cameras_ms + daemon.receiver_ms):.0f}",
            row.ended_by,
        ]
        lines.append(" | ".join(cells))
    return "\n".join(f"|{line}|" if line.startswith("-") else f"| {line} |" for line in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="smallest and largest sensor, short trials")
    parser.add_argument("--size", choices=SIZES, action="append", help="only this one")
    parser.add_argument("--transport", choices=get_args(Transport), action="append", help="only this one")
    parser.add_argument("--pixel-format", choices=PIXEL_FORMATS, default="Mono8", metavar="NAME", help="(%(default)s)")
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the figures to this file")
    arguments = parser.parse_args()
    sizes, seconds, fine = ((SIZES[0], SIZES[-1]), 2.0, 1) if arguments.quick else (SIZES, 3.0, 2)
    load, literal_ms = os.getloadavg()[0], [reference_step_ms(30)]
    pixel_format = PIXEL_FORMATS[arguments.pixel_format]
    transports = arguments.transport or get_args(Transport)
    rows = measure(
        [Cell(transport, size, pixel_format) for transport in transports for size in arguments.size or sizes],
        seconds,
        fine,
    )
    literal_ms.append(reference_step_ms(30))
    step_ms = statistics.mean(literal_ms)
    print(
        f"Two fake cameras, {pixel_format}, still scene: pairs per second held for {seconds:g} s without loss.\n"
        f"Links: GigE {GIGE_MBPS} Mb/s, packets of {PACKET_BYTES} bytes; USB3 {USB3_MBPS} Mb/s; one for both cameras.\n"
        f"Work is processor time in literal steps (benchmarks/README.md), which took {literal_ms[0]:.1f} ms before and "
        f"{literal_ms[1]:.1f} ms after.\n"
        f"The load average was {load:.1f} on {cores():g} cores before it began: other programs lower the rates.\n\n"
        f"{table(rows, step_ms)}"
    )
    if arguments.json:
        result: dict[str, Any] = {"literal_ms": literal_ms, "rows": [asdict(row) for row in rows]}
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
