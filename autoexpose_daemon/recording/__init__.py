"""Runs kept on disk, and played again through any policy."""

from importlib.util import find_spec

from drivers.errors import ConfigurationError


def check_recording_extra() -> None:
    """Raise a ConfigurationError when what recordings are written and read with is not installed."""
    if find_spec("mcap") is None or find_spec("rosbags") is None:
        raise ConfigurationError("recordings need the extra `record`: pip install 'autoexpose-daemon[record]'")
