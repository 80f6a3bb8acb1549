"""Error class of the readers."""

from pdr_filter.values.sanitise import printable_lines


class RecordingError(ValueError):
    """Error for a recording that cannot be used, a ValueError.

    The message names the file, the column, the value and the remedy.

    Parameters
    ----------
    message : str
        Text, which may quote untrusted files. Control characters are made printable.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> raise pdr.RecordingError("walk.csv: no column of time; add one")
    Traceback (most recent call last):
        ...
    pdr_filter.values.errors.RecordingError: walk.csv: no column of time; add one
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable_lines(message))
