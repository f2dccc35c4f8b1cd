"""`autoexpose calibrate` as a user meets it."""

from __future__ import annotations

from typer.testing import CliRunner

from calibration.commands.app import calibrate_app
from imaging.errors import AutoexposeError


def calibrate(*arguments: str) -> tuple[int, str]:
    """Exit code and output, as `autoexpose` gives them."""
    result = CliRunner().invoke(calibrate_app, arguments)
    if isinstance(result.exception, AutoexposeError):
        return 1, f"autoexpose: {result.exception}"
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout


def done(*arguments: str) -> str:
    """The output of a command that succeeds."""
    code, output = calibrate(*arguments)
    assert code == 0, output
    return output


def refused(*arguments: str) -> str:
    """The output of a command that fails."""
    code, output = calibrate(*arguments)
    assert code == 1, output
    return output
