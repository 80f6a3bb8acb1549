"""The one error of the readers."""


class RecordingError(ValueError):
    """A recording that cannot be used; the message names the file, the column, the value and the remedy."""
