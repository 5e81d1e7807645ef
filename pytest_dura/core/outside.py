"""Failures outside of the component that come up within its own calls, such as a cassette's miss.

The component may let such an error pass or catch it, and neither says anything about it: whoever
raises the error tells the loop of it at the same time, and the loop ends the episode as missing.
"""

from __future__ import annotations

from pytest_dura.core.errors import DuraError


class OutsideError(DuraError):
    """What the component rests on failed, not the component. Raise it as ``raise told(error)``.

    Args:
        source: What failed, in one word, such as ``cassette``.
        problem: What is wrong and how to mend it, in bounded length.
    """

    def __init__(self, source: str, problem: str) -> None:
        self.source = source
        super().__init__(problem)


_LISTENERS: list[list[OutsideError]] = []


def told(error: OutsideError) -> OutsideError:
    """Tell the loop, whatever the component makes of the error; returns it, to be raised."""
    if _LISTENERS:
        _LISTENERS[-1].append(error)
    return error


class listening:  # noqa: N801 - reads like a statement
    """Context with a list that is filled with what is told meanwhile.

    Of nested ones the innermost hears it. A class, since it is entered at each tick.
    """

    def __enter__(self) -> list[OutsideError]:
        """Begin to listen."""
        heard: list[OutsideError] = []
        _LISTENERS.append(heard)
        return heard

    def __exit__(self, *_: object) -> None:
        """Listen no more."""
        _LISTENERS.pop()
