"""The durations that the daemon measures, declared once: telemetry, status, terminal, page and metrics follow."""

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
        Its name in words, for terminal and page.
    meaning
        What is measured, in a sentence.
    """

    field: str
    label: str
    meaning: str


DURATIONS = (
    Duration("pairing_ms", "pairing", "From a pair in memory to the control step on it."),
    Duration("decision_ms", "decision", "One control step."),
    Duration("held_ms", "hold", "From a decision to the start of the safe write window."),
    Duration("write_ms", "write", "Writing exposure time and gain to a camera."),
    Duration("frame_to_node_ms", "frame to node", "From a pair in memory to the end of writing the decision on it."),
    Duration("command_to_effect_ms", "command to effect", "From a decision to the first exposure taken with it."),
    Duration("skew_ms", "skew", "Between the starts of a pair's two exposures, by the cameras' time stamps."),
)
"""In the order in which a frame goes through them; the first four follow without a gap, and add up to frame to node."""
