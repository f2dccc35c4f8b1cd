"""What can be wrong with a message."""


class DamagedMessageError(ValueError):
    """Bytes that are not the message they should be."""
