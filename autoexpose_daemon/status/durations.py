"""What the daemon measures of its own speed, declared once: telemetry, status, terminal and metrics follow."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Duration:
    """One of the durations.

    Attributes
    ----------
    field
        Its name in `Telemetry`, in `Status` and in the demo's summary.
    label
        Its name in a terminal.
    metric
        Its name in Prometheus, between `autoexpose_` and `_seconds`.
    meaning
        From when to when, in a sentence.
    """

    field: str
    label: str
    metric: str
    meaning: str


DURATIONS = (
    Duration("pairing_ms", "pairing", "pairing", "From a pair in memory to the step of control on it."),
    Duration("decision_ms", "decision time", "loop", "One step of the control loop."),
    Duration("held_ms", "held", "held", "From a decision to the start of writing it: held for the write window."),
    Duration("write_ms", "write time", "write", "Writing exposure time and gain to a camera."),
    Duration("frame_to_node_ms", "frame to node", "frame_to_node", "From a pair in memory to the end of that write."),
    Duration(
        "command_to_effect_ms",
        "command to effect",
        "command_to_effect",
        "From a decision to the first exposure that shows it.",
    ),
)
"""In their order on the way of a frame. Pairing, decision, held and write follow each other without a gap, and together
are frame to node."""
