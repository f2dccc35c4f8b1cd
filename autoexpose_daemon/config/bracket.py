"""Brackets asked for on the command line."""

from __future__ import annotations

import math
import re

from pydantic import ValidationError

from autoexpose_daemon.config.control import BracketConfig
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.mistakes import mistakes
from imaging.errors import ConfigurationError

_RANGE = re.compile(r"1:(\d{1,9}(?:\.\d+)?)")


def bracketed(config: Config, bracket: bool, exposures: int | None, range_: str | None, keep: bool) -> Config:
    """A configuration with the brackets that options ask for; without `bracket`, the configuration itself.

    Parameters
    ----------
    config
        What it is otherwise; its own brackets give what the options leave open.
    bracket, exposures, range_, keep
        The options; `range_` as in ``1:64``.

    Raises
    ------
    ConfigurationError
        Naming the option at fault.
    """
    if not bracket:
        if exposures is not None or range_ is not None or keep:
            raise ConfigurationError("--exposures, --range and --keep are for brackets: add --bracket")
        return config
    given: dict[str, object] = {} if exposures is None else {"exposures": exposures}
    if range_ is not None:
        given["range_stops"] = _stops(range_)
    if keep:
        given["keep"] = True
    own = {} if config.control.bracket is None else config.control.bracket.model_dump()
    try:
        brackets = BracketConfig.model_validate({**own, **given})
    except ValidationError as error:
        raise ConfigurationError(f"--bracket: {mistakes(error, BracketConfig)[0]}") from error
    return config.model_copy(update={"control": config.control.model_copy(update={"bracket": brackets})})


def _stops(range_: str) -> float:
    match = _RANGE.fullmatch(range_)
    if match is None or float(match[1]) <= 1.0:
        raise ConfigurationError(f"--range {range_} is no range: give 1:N, as in 1:64")
    return math.log2(float(match[1]))
