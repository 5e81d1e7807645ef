"""``python -m pytest_dura``: new projects, evidence, and the commands of guests."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO

from pytest_dura import __version__
from pytest_dura.core.errors import ConfigurationError, import_error
from pytest_dura.core.registry import Registry
from pytest_dura.evidence.text import one_line, visible, without_commands

_USAGE_ERROR = 2
_NOT_RENDERED = 3
_SIGNING = "--key needs further packages, of 21 MB: pip install 'pytest-dura[signing]'"
_MAX_LENGTH = 2000
"""Characters of a printed line, which may quote a damaged record."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command, and return the exit code.

    0 if it succeeded: a bundle is intact, the gate of merged bundles passed; 1 if something
    differs, or the gate failed; 2 for a wrong call, and for bundles that cannot be merged; 3 if all
    that could be compared is equal, but the formats could not be rendered again.
    """
    parser = argparse.ArgumentParser(prog="python -m pytest_dura", description=__doc__)
    parser.add_argument(
        "-p",
        dest="modules",
        metavar="MODULE",
        action="append",
        default=[],
        help="import this module first, as pytest does: what it registers is then known",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    init = commands.add_parser(
        "init", help="make a project: a planner, a scenario, a requirement, a CI file"
    )
    init.add_argument("directory", metavar="DIR", type=Path, help="a new or an empty directory")
    init.add_argument(
        "--domain",
        action="store_true",
        help="of a system of one's own: a tank with simulator, domain, controller, fault and test",
    )
    verify = commands.add_parser(
        "verify",
        help="check that a bundle is whole and agrees with itself",
        epilog=_SIGNING,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verify.add_argument("directory", metavar="DIR", type=Path, help="the evidence directory")
    verify.add_argument(
        "--junit-xml",
        metavar="FILE",
        type=Path,
        help="compare it with the session's JUnit file, too",
    )
    verify.add_argument(
        "--key",
        metavar="FILE",
        type=Path,
        action="append",
        default=[],
        help="check that this public key (PEM), or another one given so, signed the bundle, and "
        "the review if there is one",
    )
    export = commands.add_parser(
        "export", help="add a format to a bundle: CycloneDX, in-toto, sphinx-needs"
    )
    export.add_argument(
        "format",
        metavar="FORMAT",
        help="cyclonedx, in-toto, needs, or the short name of another package's format",
    )
    export.add_argument("directory", metavar="DIR", type=Path, help="the evidence directory")
    export.add_argument(
        "--output", metavar="FILE", type=Path, help="write it there, and leave the bundle as it is"
    )
    sign = commands.add_parser(
        "sign",
        help="sign a bundle, and a review of it, so that others can check who made them",
        epilog=_SIGNING,
        formatter_class=argparse.RawDescriptionHelpFormatter,  # a command is not wrapped
    )
    sign.add_argument("directory", metavar="DIR", type=Path, help="the evidence directory")
    sign.add_argument(
        "--key", metavar="FILE", type=Path, required=True, help="the private key (PEM)"
    )
    sign.add_argument(
        "--review",
        metavar="FILE",
        type=Path,
        help="a YAML file with who, when, what and decision: reports then name the reviewer",
    )
    merge = commands.add_parser(
        "merge", help="join the bundles of all shards of a session, and gate on the whole"
    )
    merge.add_argument(
        "bundles", metavar="BUNDLE", type=Path, nargs="+", help="evidence of --dura-shard"
    )
    merge.add_argument(
        "--output", metavar="DIR", type=Path, required=True, help="where the whole goes"
    )
    merge.add_argument(
        "--baseline", metavar="PATH", help="compare the whole with this earlier evidence"
    )
    merge.add_argument(
        "--baseline-worse",
        choices=("fail", "warn"),
        default="warn",
        help="what a rate that got worse than the baseline's does to the gate (default: warn)",
    )
    compare = commands.add_parser(
        "compare", help="show the components of several bundles side by side"
    )
    compare.add_argument(
        "directories",
        metavar="DIR",
        type=Path,
        nargs="+",
        help="evidence directories; the others are held against the first component",
    )
    compare.add_argument(
        "--all", action="store_true", help="show each verdict, and the pairs of each case"
    )
    compare.add_argument(
        "--json", metavar="FILE", type=Path, help="write everything to this file, too"
    )
    given = sys.argv[1:] if arguments is None else arguments
    if not _is_own(given):  # no module of a guest is loaded for a command of ours, such as verify
        for name, command in COMMANDS.items():
            command.add_arguments(commands.add_parser(name, help=command.SUMMARY))
    try:
        options = parser.parse_args(given)
        for module in options.modules:
            _import(module)
        return _COMMANDS.get(options.command, _run_registered)(options)
    except BrokenPipeError:  # the reader, such as `head`, has ended
        # Flushing at exit would raise it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except ConfigurationError as error:
        _print(visible(str(error), _MAX_LENGTH), file=sys.stderr)
        return _USAGE_ERROR


def _is_own(given: Sequence[str]) -> bool:
    """Whether arguments name a command of this module."""
    words = iter(given)
    for word in words:
        if word == "-p":
            next(words, None)
        elif not word.startswith("-"):
            return word in _COMMANDS
    return False


def _run_registered(options: argparse.Namespace) -> int:
    code = 0

    def lines() -> Iterator[str]:
        nonlocal code
        code = (yield from COMMANDS[options.command].run(options)) or 0

    for line in lines():
        _print(line)
    return code


def _import(module: str) -> None:
    """Import a module that the caller names.

    Raises:
        ConfigurationError: If it cannot be imported.
    """
    try:
        import_module(module)
    except Exception as error:
        raise import_error(
            error, "a module cannot be imported", module=module, found=module,
            expected="the name of a module on the import path", remedy="correct -p",
        ) from None  # fmt: skip


def _init(options: argparse.Namespace) -> int:
    from pytest_dura.new_project import write_project

    files = write_project(options.directory, own_domain=options.domain)
    _print_any_file_name()
    for file in files:
        _print(f"written: {one_line(str(options.directory / file), _MAX_LENGTH)}")
    _print("run `pytest` there")
    return 0


def _merge(options: argparse.Namespace) -> int:
    from pytest_dura.evidence.baseline import Baseline
    from pytest_dura.evidence.merge import merge_bundles
    from pytest_dura.reports.wording import merged_parts_text

    fail_worse, path = options.baseline_worse == "fail", options.baseline
    if fail_worse and path is None:
        raise ConfigurationError(
            "--baseline-worse is about a baseline, and there is none",
            key="--baseline-worse",
            found="fail",
            remedy="add --baseline=evidence.json",
        )
    baseline = None if path is None else Baseline.read(path, Path.cwd())
    merged = merge_bundles(options.bundles, options.output, baseline, fail_worse=fail_worse)
    _print_any_file_name()
    for reason in merged.gate.reasons:
        _print(one_line(reason, _MAX_LENGTH))
    totals = merged.totals
    verdicts = totals.supported + totals.violated + totals.undecided
    _print(
        f"{merged_parts_text(merged)}, {totals.cases} cases, {totals.episodes} episodes, "
        f"{verdicts} verdicts; gate of the whole: {totals.gate}"
    )
    _print(f"evidence: {one_line(str(options.output / 'report.html'), _MAX_LENGTH)}")
    return 0 if merged.gate.result == "passed" else 1


def _compare(options: argparse.Namespace) -> int:
    from pytest_dura.evidence.side_by_side import compare_bundles
    from pytest_dura.reports.pens.terminal import TerminalPen
    from pytest_dura.reports.side_by_side import document_of

    result = compare_bundles(options.directories)
    _print_any_file_name()
    document = document_of(result, everything=options.all)
    for line in TerminalPen(document, lambda entry: entry.text, verbose=True).lines():
        _print(line.text)
    if options.json is not None:
        try:
            options.json.write_text(json.dumps(result.to_json(), indent=1) + "\n", "utf-8")
        except OSError as error:
            raise ConfigurationError(
                f"the comparison cannot be written: {error.strerror}",
                file=str(options.json),
                key="--json",
                remedy="name a file that can be written",
            ) from None
    return 0


def _print(text: str, file: TextIO | None = None) -> None:
    """Print lines on which no CI acts."""
    print(without_commands(text), file=file, flush=True)


def _print_any_file_name() -> None:
    if isinstance(sys.stdout, TextIOWrapper):  # a file's name need not be text
        sys.stdout.reconfigure(errors="backslashreplace")


def _export(options: argparse.Namespace) -> int:
    from pytest_dura.evidence.bundle import export_file, exported_file

    name = exported_file(options.format, "FORMAT")
    written = export_file(options.directory, name, options.output)
    _print_any_file_name()
    _print(f"written: {one_line(str(written), _MAX_LENGTH)}")
    return 0


def _sign(options: argparse.Namespace) -> int:
    from pytest_dura.evidence.bundle import RECORD_FILE, add_format, open_record, render_again
    from pytest_dura.evidence.signing import (
        STATEMENT_FILE,
        Review,
        check_private_key,
        sign_statement,
        write_review,
    )
    from pytest_dura.evidence.verify import verify_bundle
    from pytest_dura.library.documents import read_yaml, validate
    from pytest_dura.reports.wording import review_text

    review = None if options.review is None else validate(Review, read_yaml(options.review))
    bundle = verify_bundle(options.directory, signed=True)
    if bundle.problems or (review is not None and bundle.not_rendered is not None):
        raise ConfigurationError(
            "this bundle is not intact"
            if bundle.problems
            else "another version of pytest-dura wrote this bundle, and must render the review",
            file=str(options.directory),
            found=bundle.problems[0] if bundle.problems else bundle.not_rendered,
            expected="a bundle that `python -m pytest_dura verify` finds intact",
            remedy="restore it, or run the session again"
            if bundle.problems
            else "sign it with that version",
        )
    record = open_record(options.directory / RECORD_FILE)
    check_private_key(options.key)
    if review is not None:
        ended = record.head.finished or record.head.created
        write_review(options.directory, review, options.key, ended)
        render_again(record)
    if not (options.directory / STATEMENT_FILE).exists():
        add_format(record, STATEMENT_FILE)
    key_id = sign_statement(options.directory, options.key)
    _print_any_file_name()
    if review is not None:
        text = review_text(record).removeprefix("generated; ")
        _print(one_line(f"reviewed: {text}", _MAX_LENGTH))
    _print(f"signed: {one_line(str(options.directory), _MAX_LENGTH)} with the key {key_id}")
    return 0


def _verify(options: argparse.Namespace) -> int:
    from pytest_dura.evidence.signing import check_signatures
    from pytest_dura.evidence.verify import verify_bundle

    bundle = verify_bundle(options.directory, options.junit_xml, signed=bool(options.key))
    head = bundle.head
    signatures = check_signatures(
        options.directory,
        options.key,
        gate="" if head is None else head.gate.result,
        ended=None if head is None else head.finished or head.created,
    )
    bundle.problems += signatures.problems
    _print_any_file_name()
    for line in signatures.lines:
        _print(one_line(line, _MAX_LENGTH))
    for problem in bundle.problems:
        _print(one_line(problem, _MAX_LENGTH))
    if bundle.totals is not None:
        totals = bundle.totals
        verdicts = totals.supported + totals.violated + totals.undecided
        _print(
            f"{bundle.files} files, {totals.episodes} episodes, {verdicts} verdicts, "
            f"{len(bundle.rejudged)} of their judgements made again on traces; "
            f"gate {totals.gate}"
        )
    if bundle.intact and bundle.not_rendered is not None:
        _print(
            f"not re-rendered: pytest-dura {one_line(bundle.not_rendered, _MAX_LENGTH)} wrote this "
            f"bundle, and this is {__version__}: the hashes hold, and concluding from the episodes "
            "gives the record; whether rendering it gives the files was not checked"
        )
        return _NOT_RENDERED
    plural = "" if len(bundle.problems) == 1 else "s"
    _print("intact" if bundle.intact else f"NOT INTACT: {len(bundle.problems)} difference{plural}")
    return 0 if bundle.intact else 1


_COMMANDS: Mapping[str, Callable[[argparse.Namespace], int]] = {
    "init": _init,
    "verify": _verify,
    "export": _export,
    "sign": _sign,
    "merge": _merge,
    "compare": _compare,
}

COMMANDS: Registry[Any] = Registry(
    "pytest_dura.commands",
    "command",
    lambda value: callable(getattr(value, "add_arguments", None)) and hasattr(value, "SUMMARY"),
    "a module with SUMMARY, add_arguments(parser), and run(options) that yields lines to print",
    reserved=tuple(_COMMANDS),
)
"""Further commands, of guests and of other packages."""


if __name__ == "__main__":
    sys.exit(main())
