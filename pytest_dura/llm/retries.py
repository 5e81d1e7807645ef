"""Retries: requests that are made again because their server was not available.

Nothing else is repeated: what a model answers counts, whatever it is. A server is not available
where it answers 429 or 503, or the connection to it fails.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from email.utils import parsedate_to_datetime

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.port import Answer

RETRIES = "DURA_LLM_RETRIES"
"""The environment variable with the greatest number of retries of a request."""
MOST_RETRIES = 20
LONGEST_PAUSE = 60.0
"""Seconds; a server that wants to be left alone for longer is not asked again."""
_FIRST_PAUSE, _LONGEST_OWN_PAUSE = 0.5, 8.0
"""Seconds before the first retry, doubled for each further one up to the second, where the server
does not say when."""
_CAUSES = ("HTTP 429", "HTTP 503", "connection")
_SECONDS = re.compile(r"\d{1,9}(\.\d{1,9})?")


def retries_of(environ: Mapping[str, str]) -> int:
    """The greatest number of retries that an environment allows; 0 if it does not say.

    Raises:
        ConfigurationError: If it is no number from 0 to 20.
    """
    text = environ.get(RETRIES, "").strip()
    if not text:
        return 0
    if not (text.isascii() and text.isdecimal()) or len(text) > 3 or int(text) > MOST_RETRIES:
        raise ConfigurationError(
            "the number of retries cannot be used",
            key=RETRIES,
            found=text[:80],
            expected=f"a whole number from 0 to {MOST_RETRIES}",
            remedy=f"correct it, or unset {RETRIES}",
        )
    return int(text)


def retry_after(headers: Mapping[str, str]) -> float | None:
    """Seconds that a response's ``Retry-After`` asks for, as a number or as a date.

    A date is compared with the response's own ``Date``, since clocks differ; where there is none,
    with this machine's. ``None`` without the header, and for a text that is neither.

    Args:
        headers: Of the response; their names in lower case are known.
    """
    text = headers.get("retry-after", "").strip()
    if _SECONDS.fullmatch(text):
        return float(text)
    until = _date(text)
    if until is None:
        return None
    now = _date(headers.get("date", "")) or datetime.now(timezone.utc)
    return max((until - now).total_seconds(), 0.0)


def _date(text: str) -> datetime | None:
    try:
        date = parsedate_to_datetime(text.strip())
    except (ValueError, TypeError, IndexError, OverflowError):  # no date at all
        return None
    return date if date.tzinfo else date.replace(tzinfo=timezone.utc)


@dataclass(frozen=True)
class Retries:
    """Rule for repeating a request.

    Args:
        most: Greatest number of retries of a request; 0 for none.
        sleep: Waits for so many seconds.
    """

    most: int = 0
    sleep: Callable[[float], None] = time.sleep

    def time_for(self, limit: float) -> float:
        """Longest time in s that a request takes whose every call may take ``limit`` seconds."""
        return (self.most + 1) * limit + self.most * LONGEST_PAUSE

    def pause(self, answer: Answer, attempts: int) -> float | None:
        """Seconds until the request is made again; ``None`` if it is not.

        Args:
            answer: The latest answer.
            attempts: Calls that were made by now.
        """
        if attempts > self.most or answer.cause not in _CAUSES:
            return None
        if answer.retry_after is not None:
            return answer.retry_after if answer.retry_after <= LONGEST_PAUSE else None
        return min(_FIRST_PAUSE * 2.0 ** (attempts - 1), _LONGEST_OWN_PAUSE)

    def ask(self, call: Callable[[float], Answer], limit: float, *, counted: bool) -> Answer:
        """The answer of the last call that was needed, with the number of calls.

        Args:
            call: Makes one call within so many seconds.
            limit: Seconds for each call; for all calls and pauses together where they count.
            counted: Whether they count as part of the component's latency.
        """
        start, attempts, waited = time.monotonic(), 1, 0.0
        answer = call(limit)
        while (pause := self.pause(answer, attempts)) is not None:
            left = limit - (time.monotonic() - start) - pause if counted else math.inf
            if left <= 0.0:
                break
            self.sleep(pause)
            attempts, waited = attempts + 1, time.monotonic() - start
            answer = call(limit - waited if counted else limit)
        return answer if attempts == 1 else replace(answer, attempts=attempts, waited=waited)
