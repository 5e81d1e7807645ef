"""Classes, told from what only says that it is a type."""

from __future__ import annotations

import pytest

from pytest_dura.core.classes import is_subclass


class Alias:
    """Says that it is a type, as ``list[int]`` does on Python 3.10."""

    __class__ = property(lambda _: type)


@pytest.mark.parametrize("value", [Alias(), list[int], 1, "int", None, str, type])
def test_what_is_not_a_class_of_the_kind_is_refused_without_an_error(value):
    assert not is_subclass(value, int)


@pytest.mark.parametrize("value, base", [(bool, int), (int, int), (type, type), (Alias, Alias)])
def test_a_class_is_of_its_own_kind_and_of_those_that_it_extends(value, base):
    assert is_subclass(value, base)
