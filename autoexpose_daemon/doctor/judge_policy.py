"""Whether the configured policy can work on this host."""

from __future__ import annotations

from collections.abc import Iterator

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.doctor.finding import Finding
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction


def judge_policy(config: Config) -> Iterator[Finding]:
    """Build it as the daemon would."""
    limits, start = config.exposure.limits(), config.start
    try:
        from autoexpose_daemon.control.loop import ControlLoop  # noqa: PLC0415  needs the C extension

        ControlLoop(config.control.policy, ResponseFunction.linear(), limits, start, config.control.parameters())
    except ConfigurationError as error:
        yield Finding("policy", "stops", str(error))
