"""What the steps of control go out through, as configured."""

from __future__ import annotations

import logging

from autoexpose_daemon.config import Config
from autoexpose_daemon.publish.tally import PublishTally
from autoexpose_daemon.runtime import Daemon

log = logging.getLogger(__name__)


def add_outlets(daemon: Daemon, config: Config) -> Daemon:
    """Have a daemon publish, if configured; without the Python packages for it the daemon goes on and says so."""
    if config.publish is None:
        return daemon
    try:
        from autoexpose_daemon.publish.publisher import Publisher  # noqa: PLC0415  an extra
    except ImportError as error:
        trouble = f"{error.name} is missing: pip install 'autoexpose-daemon[publish]'"
        log.warning("frames are not published: %s", trouble)
        daemon.telemetry.publishing = PublishTally(trouble=trouble)
        return daemon
    publisher = Publisher(config.publish, len(config.sides))
    daemon.outlets.append(publisher)
    daemon.telemetry.publishing = publisher.tally
    return daemon
