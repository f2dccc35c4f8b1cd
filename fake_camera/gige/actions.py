"""Action commands on the network: which of them concern this camera, and how they are acknowledged."""

from __future__ import annotations

from collections.abc import Mapping

from fake_camera.device.actions import ActionOutcome
from fake_camera.device.device import Device
from fake_camera.device.faults import Fault
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.status import Status
from fake_camera.gige.gvcp import Action

_STATUS = {
    ActionOutcome.NOW: Status.SUCCESS,
    ActionOutcome.SCHEDULED: Status.SUCCESS,
    ActionOutcome.LATE: Status.ACTION_LATE,
    ActionOutcome.OVERFLOW: Status.OVERFLOW,
    ActionOutcome.NO_REFERENCE_TIME: Status.NO_REF_TIME,
}

_IEEE_1588 = 1 << 19
_EXTENDED_STATUS = 1 << 18
_UNCONDITIONAL_ACTIONS = 1 << 3


class ActionChannel:
    """Takes action commands for one camera, and holds the register that configures GVCP.

    The status codes of GigE Vision 2.0 are on at power-on, so that a client need not know that they can be off.
    `clock_states` are the numbers of the states of a PTP port, if they are not those of IEEE 1588.
    """

    def __init__(
        self, device: Device, privilege: ControlPrivilege, clock_states: Mapping[str, int] | None = None
    ) -> None:
        self._clock_states = clock_states or {}
        self._device = device
        self._privilege = privilege
        self.reset()

    def reset(self) -> None:
        """Back to the power-on state."""
        self._extended_status = True

    def act(self, action: Action) -> Status | None:
        """Act as commanded; None when the command is not for this camera, which then stays silent."""
        features = self._device.features
        if self._device.faults.spoils_command(Fault.LOSE_ACTIONS):
            return None
        controlled = self._privilege.holder is not None or features.get("ActionUnconditionalMode") == "On"
        for_this_camera = (
            action.device_key == features.get("ActionDeviceKey")
            and action.group_key == features.get("ActionGroupKey")
            and action.group_mask & int(features.get("ActionGroupMask"))
        )
        if not (controlled and for_this_camera):
            return None
        status = _STATUS[self._device.action(action.time_ns)]
        return status if status is Status.SUCCESS or self._extended_status else Status.ERROR

    @property
    def clock_state(self) -> int:
        """The IEEE 1588 status register."""
        assert self._device.ptp is not None
        state = self._device.ptp.state
        return self._clock_states.get(state.name, state)

    @property
    def configuration(self) -> int:
        """The GVCP configuration register."""
        features = self._device.features
        return (
            _IEEE_1588 * bool(features.get("PtpEnable"))
            | _EXTENDED_STATUS * self._extended_status
            | _UNCONDITIONAL_ACTIONS * (features.get("ActionUnconditionalMode") == "On")
        )

    @configuration.setter
    def configuration(self, value: int) -> None:
        features = self._device.features
        features.set("PtpEnable", bool(value & _IEEE_1588))
        features.set("ActionUnconditionalMode", "On" if value & _UNCONDITIONAL_ACTIONS else "Off")
        self._extended_status = bool(value & _EXTENDED_STATUS)
