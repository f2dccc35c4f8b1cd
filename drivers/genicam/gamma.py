"""Switching the camera's gamma off, so that grey levels are proportional to light."""

from __future__ import annotations

from drivers.genicam.hold import hold, switch
from drivers.genicam.nodes import NodeMap
from imaging.errors import NodeError

SWITCHES = ("GammaEnable", "GammaEnabled")
"""Names of the switch by vendor: Basler and FLIR's newer cameras, FLIR's older ones."""


def switch_gamma_off(nodes: NodeMap) -> tuple[str, ...]:
    """Switch gamma off, or set it to 1, and return the limitations, in words."""
    try:
        for name in SWITCHES:
            if nodes.available(name):
                switch(nodes, name, False)
                return ()
        if nodes.is_float("Gamma"):
            hold(nodes, "Gamma", 1.0)
    except NodeError as error:
        return (f"gamma cannot be switched off, so grey levels are not proportional to light ({error})",)
    return ()
