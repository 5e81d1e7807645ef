from .baseline import Baseline, claims_of, compare_claims
from .bundle import (
    FORMATS,
    RECORD_FILE,
    all_formats,
    open_record,
    write_bundle,
    write_record,
)
from .conclude import complete, conclude
from .conclusions.cases import CaseMetrics, Cases
from .conclusions.coverage import Coverage
from .conclusions.effectiveness import Effectiveness
from .conclusions.failure_modes import FailureModes
from .conclusions.tables import TABLES, Claim, ConcludedColumn, Table, all_tables
from .conclusions.verdicts import UNKNOWN_COMPONENT
from .entry import plain_data
from .episodes import episode_record
from .files import (
    MANIFEST_FILE,
    DirectoryLock,
    InputFiles,
    file_entry,
    files_below,
    manifest_problems,
    manifest_text,
)
from .gate import Gate
from .gather import SCHEMA_VERSION, RecordBuilder
from .junit import junit_name
from .mcap import pack_columns, read_trace, trace_bytes, unpack_columns, write_trace
from .merge import merge_bundles
from .model import SessionRecord
from .redaction import Redactor, count_redactions, holds_redaction
from .schema import check_record, record_schema
from .shard_units import ShardUnit, plan_digest, split_units
from .text import LINE, code, markdown, name, one_line, visible
from .traces import Trace, episode_name, first_difference, is_trace_path, trace_path
from .verify import record_problems, verify_bundle

__all__ = [
    "FORMATS",
    "LINE",
    "MANIFEST_FILE",
    "RECORD_FILE",
    "SCHEMA_VERSION",
    "TABLES",
    "UNKNOWN_COMPONENT",
    "Baseline",
    "CaseMetrics",
    "Cases",
    "Claim",
    "ConcludedColumn",
    "Coverage",
    "DirectoryLock",
    "Effectiveness",
    "FailureModes",
    "Gate",
    "InputFiles",
    "RecordBuilder",
    "Redactor",
    "SessionRecord",
    "ShardUnit",
    "Table",
    "Trace",
    "all_formats",
    "all_tables",
    "check_record",
    "claims_of",
    "code",
    "compare_claims",
    "complete",
    "conclude",
    "count_redactions",
    "episode_name",
    "episode_record",
    "file_entry",
    "files_below",
    "first_difference",
    "holds_redaction",
    "is_trace_path",
    "junit_name",
    "manifest_problems",
    "manifest_text",
    "markdown",
    "merge_bundles",
    "name",
    "one_line",
    "open_record",
    "pack_columns",
    "plain_data",
    "plan_digest",
    "read_trace",
    "record_problems",
    "record_schema",
    "split_units",
    "trace_bytes",
    "trace_path",
    "unpack_columns",
    "verify_bundle",
    "visible",
    "write_bundle",
    "write_record",
    "write_trace",
]
