"""Declared exposure and pairs of parameters, from a scenario file to record, page and summary."""

import json

import pytest

pytest_plugins = ["pytester"]
