"""Parameters and services by which ROS 2 sets control: each asks the daemon, whose word is final."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from autoexpose_client import AutoexposeError, MessageClient
from autoexpose_msgs.srv import Shot
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from autoexpose_ros.settings import Setting, geometry_of, requests, settings
from autoexpose_ros.status import Status, control_of

SILENT = "nothing heard from the daemon: is it running?"
_STALE_S = 3.0
"""How long a status may follow a request that does not know of it yet."""


class Controls:
    """The parameters and services of a rig, from when it is made until it is closed."""

    def __init__(self, node: Node, client: MessageClient) -> None:
        self._node, self._client = node, client
        self._by = f"ROS 2 node {node.get_fully_qualified_name()}"[:64]
        self._status: Status | None = None
        self._values: dict[str, Any] = {}
        self._following = False
        self._taken: dict[str, int] = {}  # how many requests each group had taken with the latest of ours
        self._taken_s = 0.0
        self._group = MutuallyExclusiveCallbackGroup()  # a shot takes a while, for which nothing else waits
        self._services: dict[str, Any] = {}
        self._serve("lock", Trigger, partial(self._lock, True))
        self._serve("unlock", Trigger, partial(self._lock, False))
        self._serve("shot", Shot, self._shoot)
        node.add_on_set_parameters_callback(self._on_set)

    def close(self) -> None:
        """Take services and parameters back."""
        self._node.remove_on_set_parameters_callback(self._on_set)
        for service in self._services.values():
            self._node.destroy_service(service)
        for name in self._values:
            self._node.undeclare_parameter(name)

    def follow(self, status: Status | None) -> None:
        """Show what applies according to the daemon; None: it is silent."""
        self._status = status
        if status is None or self._is_stale(status):
            return
        given: dict[str, Any] = {}
        for name, setting, value in settings(status):
            if name not in self._values:
                self._values[name] = value
                given[name] = self._declare(name, setting, value)
            elif value != self._values[name]:
                self._show(name, value)
        for camera in status.cameras:
            self._serve(f"{camera}/set_camera_info", SetCameraInfo, partial(self._calibrate, camera))
        if wanted := {name: value for name, value in given.items() if value != self._values[name]}:
            self._ask_for_given(wanted)

    def _is_stale(self, status: Status) -> bool:
        if time.monotonic() - self._taken_s > _STALE_S:
            return False
        return any(group.taken < self._taken.get(name, 0) for name, group in status.groups.items())

    def _declare(self, name: str, setting: Setting, value: Any) -> Any:
        """Declare a parameter; returns what somebody gave as its value at the start, or the value itself."""
        descriptor = ParameterDescriptor(description=setting.description)
        if setting.low is not None and setting.high is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=setting.low, to_value=setting.high)]
        self._following = True
        try:
            return self._node.declare_parameter(name, value, descriptor).value
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            self._node.get_logger().warning(f"{name} stays as the daemon has it: {error}")
            return self._node.declare_parameter(name, value, descriptor, ignore_override=True).value
        finally:
            self._following = False

    def _show(self, name: str, value: Any) -> None:
        self._following = True
        try:
            self._node.set_parameters([Parameter(name, value=value)])
        finally:
            self._following = False
        self._values[name] = value

    def _ask_for_given(self, wanted: Mapping[str, Any]) -> None:
        """Ask for the values that parameters were given at the start."""
        result = self._set(wanted)
        if not result.successful:
            self._node.get_logger().warning(f"{', '.join(wanted)}: {result.reason}")
            for name in wanted:
                self._show(name, self._values[name])

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        changes = {parameter.name: parameter.value for parameter in parameters if parameter.name in self._values}
        if self._following or not changes:
            return SetParametersResult(successful=True)
        return self._set(changes)

    def _set(self, changes: Mapping[str, Any]) -> SetParametersResult:
        if self._status is None:
            return SetParametersResult(successful=False, reason=SILENT)
        try:
            for request in requests(changes, self._status):
                self._ask(request)
        except (AutoexposeError, ValueError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._values.update(changes)
        return SetParametersResult(successful=True)

    def _ask(self, request: Mapping[str, Any]) -> Any:
        """Ask the daemon; raises AutoexposeError with its sentence."""
        if self._status is None:
            raise AutoexposeError(SILENT)
        answer = self._client.ask({"by": self._by, **request})
        try:
            self._taken |= {name: control_of(group).taken for name, group in answer["groups"].items()}
            self._taken_s = time.monotonic()
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise AutoexposeError("the answer is not from a daemon of this version") from error
        return answer

    def _serve(self, name: str, kind: Any, answer: Callable[[Any, Any], Any]) -> None:
        if name not in self._services:
            service = self._node.create_service(kind, f"~/{name}", answer, callback_group=self._group)
            self._services[name] = service

    def _lock(self, locked: bool, _request: Any, response: Any) -> Any:
        try:
            self._ask({"locked": locked})
            response.success, response.message = True, "locked" if locked else "unlocked"
        except AutoexposeError as error:
            response.message = str(error)
        return response

    def _shoot(self, request: Any, response: Any) -> Any:
        shot = {"exposure_time_us": request.exposure_time_us, "gain_db": request.gain_db}
        of_group = {"group": request.group} if request.group else {}
        try:
            taken = self._ask({"shot": shot, **of_group})["shot"]
            response.exposure_time_us = float(taken["setting"]["exposure_time_us"])
            response.gain_db = float(taken["setting"]["gain_db"])
            response.trigger = taken["trigger"]
            response.cameras, response.frame_ids = list(taken["frame_ids"]), list(taken["frame_ids"].values())
            response.success = True
        except (AutoexposeError, KeyError, TypeError) as error:
            response.message = str(error)
        return response

    def _calibrate(self, camera: str, request: Any, response: Any) -> Any:
        try:
            self._ask({"geometry": {camera: geometry_of(request.camera_info)}})
            response.success, response.status_message = True, "stored by the daemon"
        except AutoexposeError as error:
            response.status_message = str(error)
        return response
