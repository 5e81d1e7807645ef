"""Driving: the domain of projects that name none; every pytest run loads this module."""

from __future__ import annotations

from pytest_dura.guests import Guest


class Driving(Guest):
    """The domain of the built-in scenarios."""

    default_domain = "driving"
