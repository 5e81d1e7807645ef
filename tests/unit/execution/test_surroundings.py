"""Surroundings of a call in another process: what one call brings ends with it."""

from __future__ import annotations

import logging

from pytest_dura.execution.surroundings import applied, surroundings

CHATTY, QUIET = "test_surroundings.chatty", "test_surroundings.quiet"


def test_levels_of_loggers_end_with_the_call():
    given = surroundings() | {"coverage": None}
    with applied(given | {"levels": {CHATTY: logging.DEBUG}}) as first:
        logging.getLogger(CHATTY).debug("heard")
        logging.getLogger(QUIET).debug("not heard")
    with applied(given | {"levels": {"": logging.WARNING}}) as second:
        logging.getLogger(CHATTY).debug("no longer heard")
    assert [record["msg"] for record in first["log"]] == ["heard"]
    assert second["log"] == []
    assert logging.getLogger(CHATTY).level == logging.NOTSET
