"""The configuration in force: what a file says, and the defaults of all that it leaves open."""

from __future__ import annotations

from typing import Any

from autoexpose_daemon.config.document import Config


def effective(config: Config) -> dict[str, Any]:
    """All keys and their values, as a configuration file that means the same; without those that would be refused.

    Refused are keys without effect, such as the input line of cameras that the daemon triggers.
    """
    document: dict[str, Any] = config.model_dump(mode="json")
    control, motion, publish = document["control"], document["motion"], document["publish"]
    control["start"] = {"exposure_time_us": config.start.exposure_time_us, "gain_db": config.start.gain_db}
    if config.trigger.by_host:
        del document["trigger"]["line"], document["trigger"]["output_line"]
    if publish is None:
        del document["publish"]
    elif publish["stamp"] != "ptp":
        del publish["ptp_utc_offset_s"]
    for section in (publish, motion["imu"]):
        if section is not None and section["zenoh"] is not None:  # that file says where to listen and to connect
            for key in {"listen", "connect"} & section.keys():
                del section[key]
    for parent, key in ((motion, "imu"), (control, "bracket")):
        if parent[key] is None:
            del parent[key]
    return document
