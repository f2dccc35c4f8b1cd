"""What the daemon measures of its own speed, declared once: telemetry, status, terminal and metrics follow."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Duration:
    """One of the durations.

    Attributes
    ----------
    field
        Its name in `Telemetry`, in `Status`, in the demo's summary and, without the unit, in metrics.
    label
        Its name in a terminal.
    meaning
        From when to when, in a sentence.
    """

    field: str
    label: str
    meaning: str


DURATIONS = (
    Duration("pairing_ms", "pairing", "From a pair in memory to the step of control on it."),
    Duration("decision_ms", "decision", "One step of control."),
    Duration("held_ms", "hold before writing", "From a decision to the start of writing it, held for the safe window."),
    Duration("write_ms", "write", "Writing exposure time and gain to a camera."),
    Duration("frame_to_node_ms", "frame to node", "From a pair in memory to the end of that write."),
    Duration("command_to_effect_ms", "command to effect", "From a decision to the first exposure taken with it."),
)
"""In their order on the way of a frame. Pairing, decision, held and write follow each other without a gap, and together
are frame to node."""
