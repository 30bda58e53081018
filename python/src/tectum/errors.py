"""The two ways in which a process of a run ends before its time."""


class Refused(Exception):
    """The process cannot take part, or not any longer. `code` is its exit code: 2 for bad input, 3 where process and
    run do not fit, 4 for a failure of the process itself."""

    def __init__(self, text: str, code: int = 2) -> None:
        super().__init__(text)
        self.code = code


class Ended(Exception):
    """The run is over before its last tick."""

    code = 4


class Mistake(Refused):
    """A mistake in the author's own code, as one sentence with file and line."""

    def __init__(self, text: str) -> None:
        super().__init__(text, 4)


def error_text(cause: BaseException) -> str:
    """Type and message of an exception, in one line."""
    return " ".join(f"{type(cause).__name__} {cause}".split())
