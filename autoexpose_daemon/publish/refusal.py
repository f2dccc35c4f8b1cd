"""Messages from others are read before anyone sees them; a malformed one is refused, and logged."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TypeVar

from autoexpose_daemon.messages.read import DamagedMessageError
from autoexpose_daemon.publish.session import Take
from documents.text import readable
from drivers.log_throttle import LogThrottle

log = logging.getLogger(__name__)

_SAID_S = 60.0

_Read = TypeVar("_Read")


def reading(read: Callable[[bytes], _Read], take: Callable[[_Read], object], refuse: Callable[[], object]) -> Take:
    """Hands what `read` makes of each message to `take`.

    `refuse` is called if that raises `DamagedMessageError`, which is logged once a minute.
    """
    throttle = LogThrottle(_SAID_S)

    def take_message(key: str, data: bytes) -> None:
        try:
            message = read(data)
        except DamagedMessageError as error:
            refuse()
            if throttle.due("refused", time.monotonic_ns()):
                log.warning("a message under %s is refused: %s", key, readable(str(error)))
        else:
            take(message)

    return take_message
