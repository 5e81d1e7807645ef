from __future__ import annotations

import io
import json

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader
from traces import same, simple_trace, traces

from pytest_dura.core import ConfigurationError
from pytest_dura.evidence import pack_columns, read_trace, trace_bytes, unpack_columns, write_trace

FILE = trace_bytes(simple_trace())
COLUMNS = pack_columns(simple_trace())


@settings(derandomize=True, deadline=None, max_examples=35)
@given(traces())
def test_every_column_comes_back_bit_by_bit(trace):
    assert same(trace, unpack_columns(pack_columns(trace)))


@settings(derandomize=True, deadline=None, max_examples=20)
@given(traces())
def test_every_message_fits_its_schema(trace):
    data = trace_bytes(trace)
    assert data == trace_bytes(trace)
    reader = NonSeekingReader(io.BytesIO(data), validate_crcs=True)
    for schema, _, message in reader.iter_messages():
        told = json.loads(message.data, parse_constant=pytest.fail)
        jsonschema.validate(told, json.loads(schema.data))


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.integers(0, len(FILE) - 1), st.integers(1, 255), st.booleans())
def test_a_damaged_file_is_one_error_or_the_same_trace(place, change, cut):
    data = bytearray(FILE)
    data[place] ^= change
    file = _File(bytes(data[:place]) if cut else bytes(data))
    try:
        found = read_trace(file)
    except ConfigurationError:
        return
    assert same(found, simple_trace())


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.integers(0, len(COLUMNS) - 1), st.integers(1, 255), st.booleans())
def test_damaged_columns_are_one_error_or_the_same_trace(place, change, cut):
    data = bytearray(COLUMNS)
    data[place] ^= change
    try:
        found = unpack_columns(bytes(data[:place]) if cut else bytes(data))
    except ValueError:
        return
    assert same(found, simple_trace())


@settings(derandomize=True, deadline=None, max_examples=10)
@given(traces())
def test_a_file_holds_the_trace(trace):
    assert same(read_trace(_File(trace_bytes(trace))), trace)


def test_what_is_written_is_what_is_told(tmp_path):
    told = write_trace(tmp_path / "new" / "it.mcap", simple_trace())
    data = (tmp_path / "new" / "it.mcap").read_bytes()
    assert (data, told["bytes"]) == (FILE, len(FILE))


class _File:
    """A file in memory, which thousands of examples are faster with."""

    def __init__(self, data):
        self.data = data

    def stat(self):
        return self

    @property
    def st_size(self):
        return len(self.data)

    def read_bytes(self):
        return self.data

    def __str__(self):
        return "it.mcap"
