"""Tables in Parquet, by ``pyarrow``: columns of a struct have dotted names."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.logs.mapping import TIME_NAMES
from pytest_dura.logs.reading import RECEIPT, Columns, Topic, damaged, missing_library


def fits(path: Path) -> bool:
    """Whether a file is Parquet."""
    return path.suffix.lower() in (".parquet", ".pq") and path.is_file()


def topics(path: Path) -> list[Topic]:
    """Describe the only topic by the schema."""
    from_schema = _table(path, rows=False)
    fields, others = {}, {}
    for field in from_schema.schema:
        kind = str(field.type)
        if kind.startswith(("int", "uint", "float", "double", "half", "bool", "timestamp")):
            fields[field.name] = (field.metadata or {}).get(b"unit", b"").decode()
        else:
            others[field.name] = kind
    return [Topic("", "table", fields, others)]


def read(path: Path, wanted: Mapping[str, Collection[str]]) -> dict[str, Columns]:
    """Read columns."""
    table = _table(path)
    names = [name for fields in wanted.values() for name in fields if name in table.column_names]
    stamps = [name for name in table.column_names if name.lower() in TIME_NAMES][:1]
    time = {RECEIPT if name in stamps else name: _stamps(table, name) for name in {*stamps, *names}}
    values = {name: _numbers(table, name) for name in names}
    return {"": Columns(time, values)}


def _numbers(table: Any, name: str) -> Any:
    return table.column(name).to_numpy().astype(np.float64)


def _stamps(table: Any, name: str) -> Any:
    """Stamps as they are; those with a type of time in nanoseconds."""
    column = table.column(name).to_numpy()
    if column.dtype.kind == "M":
        return column.astype("datetime64[ns]").astype(np.int64)
    return column if column.dtype.kind in "iu" else column.astype(np.float64)


def _table(path: Path, *, rows: bool = True) -> Any:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise missing_library(path, "pyarrow") from None
    try:
        table = parquet.read_table(path) if rows else parquet.read_schema(path).empty_table()
        while any(pa.types.is_struct(field.type) for field in table.schema):
            table = table.flatten()
    except (pa.ArrowException, OSError, ValueError) as error:
        raise damaged(path, error) from None
    return table
