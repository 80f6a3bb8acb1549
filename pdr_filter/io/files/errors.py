"""The one error of the readers."""

from pdr_filter.values.sanitise import printable_lines


class RecordingError(ValueError):
    """A recording that cannot be used; the message names the file, the column, the value and the remedy.

    What is quoted of a file prints as text, whatever is in it.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable_lines(message))
