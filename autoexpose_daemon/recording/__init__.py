"""Runs recorded on disk, and replayed through any policy."""

from importlib.util import find_spec

from imaging.errors import ConfigurationError


def check_recording_extra() -> None:
    """Raise a ConfigurationError if the packages for recordings are not installed."""
    if find_spec("mcap") is None or find_spec("rosbags") is None:
        raise ConfigurationError("recordings need the extra `record`: pip install 'autoexpose-daemon[record]'")
