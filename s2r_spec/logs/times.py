"""What the times of a trace are called in a file."""

from __future__ import annotations

TIME = "t"


def no_times(what: str, called: str, there: str) -> str:
    """Return the sentence for a file without them; ``what`` is a column or an array."""
    return (
        f"there is no {what} {called!r} with the times in seconds; there are {there}. "
        f"Another name is mapped like that of a signal, for example --map {TIME}=time"
    )
