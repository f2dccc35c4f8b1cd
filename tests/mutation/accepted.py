"""Mutants that may live, each with the reason: they change nothing that anyone could notice, or nothing we promise."""

from __future__ import annotations

ACCEPTED: dict[str, str] = {}
"""By name of the mutant, as the table prints it."""
