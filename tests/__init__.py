"""The tests; they mirror the rooms that they test."""

from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
