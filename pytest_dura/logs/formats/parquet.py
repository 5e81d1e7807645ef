"""Tables in Parquet, by ``pyarrow``: columns of a struct have dotted names."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.logs.mapping import TIME_NAMES
from pytest_dura.logs.reading import RECEIPT, ROWS, Columns, Topic, damaged, missing_library


def fits(path: Path) -> bool:
    """Whether a file is Parquet."""
    return path.suffix.lower() in (".parquet", ".pq") and path.is_file()


def topics(path: Path) -> list[Topic]:
    """Describe the only topic by the schema."""
    (empty,) = _tables(path, None)
    fields, others = {}, {}
    for field in empty.schema:
        kind = str(field.type)
        if kind.startswith(("int", "uint", "float", "double", "half", "bool", "timestamp")):
            fields[field.name] = (field.metadata or {}).get(b"unit", b"").decode()
        else:
            others[field.name] = kind
    return [Topic("", "table", fields, others)]


def blocks(path: Path, wanted: Mapping[str, Collection[str]]) -> Iterator[dict[str, Columns]]:
    """Read columns, some rows at a time."""
    known = [name for topic in topics(path) for name in (*topic.fields, *topic.others)]
    names = [name for fields in wanted.values() for name in fields if name in known]
    stamps = [name for name in known if name.lower() in TIME_NAMES][:1]
    for table in _tables(path, {*stamps, *names}):
        time = {
            RECEIPT if name in stamps else name: _stamps(table, name) for name in {*stamps, *names}
        }
        dated = [name for name in stamps if str(table.schema.field(name).type).startswith("time")]
        values = {name: _numbers(table, name) for name in names}
        yield {"": Columns(time, values, "ns" if dated else "")}


def _numbers(table: Any, name: str) -> Any:
    return table.column(name).to_numpy().astype(np.float64)


def _stamps(table: Any, name: str) -> Any:
    """Stamps as they are; those with a type of time in nanoseconds."""
    column = table.column(name).to_numpy()
    if column.dtype.kind == "M":
        return column.astype("datetime64[ns]").astype(np.int64)
    return column if column.dtype.kind in "iu" else column.astype(np.float64)


def _tables(path: Path, names: Collection[str] | None) -> Iterator[Any]:
    """Yield some rows at a time of some columns; for ``None`` an empty table of all columns.

    Raises:
        ConfigurationError: For a file that cannot be read.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise missing_library(path, "pyarrow") from None
    try:
        with parquet.ParquetFile(path) as file:
            if names is None:
                yield _flat(file.schema_arrow.empty_table())
                return
            for batch in file.iter_batches(ROWS, columns=sorted(names)):
                yield _flat(pa.Table.from_batches([batch]))
    except (pa.ArrowException, OSError, ValueError) as error:
        raise damaged(path, error) from None


def _flat(table: Any) -> Any:
    """Make columns of the fields of structs."""
    from pyarrow import types

    while any(types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    return table
