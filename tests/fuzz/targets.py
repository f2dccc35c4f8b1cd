"""The table of all parsers of bytes from outside. A new one is a line here."""

from __future__ import annotations

from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.frames import read_angular_rate
from autoexpose_daemon.messages.inputs import (
    read_light_ahead,
    read_odometry,
    read_registration,
    read_tracked_cells,
    read_velocity,
)
from autoexpose_daemon.recording.file import RecordingError
from fake_camera.device.faults import FaultError
from fake_camera.device.line0 import WireError
from imaging.errors import AutoexposeError, ConfigurationError
from navigation.store import MapError
from tests.fuzz import of_fake_camera as fake
from tests.fuzz import of_host as host
from tests.fuzz import of_robot as robot
from tests.fuzz.target import Target

TARGETS = (
    Target("gvcp", fake.gvcp_commands, (), fake.gvcp_seeds),
    Target("ptp", fake.ptp_messages, (), fake.ptp_seeds),
    Target("usb3", fake.usb3_connection, (), fake.usb3_seeds),
    Target("fault-orders", fake.fault_orders, (FaultError,), fake.fault_seeds),
    Target("control-socket", fake.control_socket, (), fake.order_seeds),
    Target("light-script", fake.light_script, (ValueError,), fake.light_seeds),
    Target("radiance", fake.radiance, (ValueError,), fake.radiance_seeds),
    Target("line0", fake.wire_file, (WireError,), fake.wire_seeds),
    Target("genicam-xml", fake.description, (ValueError,), fake.description_seeds),
    Target("discovery", host.discovery, (), host.discovery_seeds),
    Target("image-bytes", host.image_bytes, (ValueError,), host.image_bytes_seeds),
    Target("sysfs", host.sysfs, (), host.sysfs_seeds),
    Target("response-file", host.response_file, (ConfigurationError,), host.response_seeds),
    Target("gain-file", host.gain_file, (ConfigurationError,), host.gain_seeds),
    Target("vignetting-file", host.vignetting_file, (ConfigurationError,), host.vignetting_seeds),
    Target("calibration-file", host.calibration_file, (ConfigurationError,), host.calibration_seeds),
    Target("config", host.config, (ConfigurationError,), host.config_seeds),
    Target("mask", host.mask, (ConfigurationError,), host.mask_seeds),
    Target("exposure-list", host.exposure_list, (ConfigurationError,), host.list_seeds),
    Target("image-file", host.image_file, (ConfigurationError,), host.image_file_seeds),
    Target("last-exposure", host.last_exposure, (), host.last_exposure_seeds),
    Target("published", host.published, (DamagedMessageError,), host.published_seeds),
    Target("imu", read_angular_rate, (DamagedMessageError,), host.imu_seeds),
    Target("odometry", read_odometry, (DamagedMessageError,), robot.odometry_seeds),
    Target("velocity", read_velocity, (DamagedMessageError,), robot.velocity_seeds),
    Target("light-ahead", read_light_ahead, (DamagedMessageError,), robot.light_ahead_seeds),
    Target("tracked-cells", read_tracked_cells, (DamagedMessageError,), robot.tracked_cells_seeds),
    Target("registration", read_registration, (DamagedMessageError,), robot.registration_seeds),
    Target("map", robot.map_file, (MapError,), robot.map_seeds),
    Target("tally", host.tally, (), host.tally_seeds),
    Target("status", host.status, (), host.status_seeds),
    Target("control-request", host.control_request, (ConfigurationError,), host.control_request_seeds),
    Target("control-answer", host.control_answer, (), host.control_answer_seeds),
    Target("grounds", host.grounds, (), host.grounds_seeds),
    Target("published-response", host.published_response, (), host.published_response_seeds),
    Target("page-request", host.page_request, (), host.page_request_seeds),
    Target("truth", host.truth, (AutoexposeError,), host.truth_seeds),
    Target("recording", host.recording, (RecordingError, ConfigurationError), host.recording_seeds),
    Target("control-setup", host.control_setup, (ValueError,), host.setup_seeds),
    Target("control-state", host.control_state, (ValueError,), host.state_seeds),
)
