"""Command ``draft``: requirements that a language model writes from a sentence."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import counted, one_line

if TYPE_CHECKING:
    from pytest_dura.drafts.roles import RoleDrafting
    from pytest_dura.drafts.rounds import Drafting
    from pytest_dura.llm.session import ModelSession

SUMMARY = (
    "let a language model draft requirements from a sentence, and keep those that catch something"
)

_LINE = 1000
"""Characters of a line."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    texts: dict[str, dict[str, Any]] = {
        "--domain": {"metavar": "NAME", "required": True, "help": "whose signals drafts may read"},
        "--output": {"metavar": "FILE", "type": Path, "help": "a new file for what passes"},
        "--llm": {
            "metavar": "URL/MODEL",
            "help": "a server and a model of it; by default the environment's",
        },
        "--dura-llm": {
            "choices": ("live", "record", "replay"),
            "default": "live",
            "help": "who answers: the server, the server and a cassette, or the cassette alone",
        },
        "--dura-cassette": {
            "metavar": "FILE",
            "type": Path,
            "default": Path("dura-cassette.sqlite"),
            "help": "where exchanges are recorded, and replayed from (default: %(default)s)",
        },
        "--rounds": {
            "metavar": "K",
            "type": int,
            "default": 3,
            "help": "times that the model is asked, at most (default: %(default)s)",
        },
        "--suite": {
            "metavar": "PATH",
            "type": Path,
            "action": "append",
            "default": [],
            "help": "files and folders of scenarios and requirements beside the built-in ones",
        },
        "--scenario": {
            "metavar": "GLOB",
            "action": "append",
            "default": [],
            "help": "scenarios to run (repeatable); by default all of the domain",
        },
        "--warns-of": {
            "metavar": "ID",
            "help": "draft monitors by a formula that warn of violations of this requirement, in "
            "place of requirements",
        },
        "--role": {
            "choices": ("generator", "recovery_planner", "safety_monitor"),
            "help": "draft a Python class of this role, in place of requirements, into a new file "
            "draft_*.py that nothing imports",
        },
        "--traces": {
            "metavar": "PATH",
            "type": Path,
            "action": "append",
            "default": [],
            "help": "judge drafts on traces of bundles, in place of runs of the scenarios",
        },
        "--mutants": {
            "choices": ("component", "all", "none"),
            "default": "component",
            "help": "parts that defects are seeded into; none keeps what may catch nothing",
        },
        "--cases": {
            "metavar": "N",
            "type": int,
            "default": 1,
            "help": "scenarios with defects for each draft: those whose margins are least "
            "(default: %(default)s)",
        },
        "--runs": {
            "metavar": "N",
            "type": int,
            "default": 1,
            "help": "runs of each case with a defect, at most (default: %(default)s)",
        },
    }
    parser.add_argument("sentence", metavar="SENTENCE", help="what is required, in your words")
    for name, given in texts.items():
        parser.add_argument(*(("-o", name) if name == "--output" else (name,)), **given)


def run(options: argparse.Namespace) -> Generator[str, None, int]:
    """Yield what became of each draft, and write those that passed.

    Returns:
        The exit code: 0 if a draft passed, else 1.

    Raises:
        ConfigurationError: For arguments, a server or a cassette that cannot be used.
    """
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.drafts.asking import Conversation
    from pytest_dura.drafts.checks import recorded_traces
    from pytest_dura.drafts.earning import Suite, domain_named
    from pytest_dura.drafts.files import ABOUT, draft_file
    from pytest_dura.drafts.monitors import ABOUT_MONITORS, MonitorDrafting
    from pytest_dura.drafts.roles import RoleDrafting, asked_for
    from pytest_dura.drafts.rounds import Drafting, Seeding

    _check(options)
    domain = domain_named(options.domain)
    suite = Suite(Runner.of(*options.suite), domain, options.scenario)
    warns_of = options.warns_of and suite.runner.requirement(options.warns_of)
    session = _session(options)
    try:
        basis, asked = asked_for(options.role, suite) if options.role else (None, {})
        about = MonitorDrafting.asked_of(warns_of) if warns_of else ""
        shown = MonitorDrafting.percept_of(domain) if warns_of else domain
        conversation = Conversation(session, shown, options.sentence, about=about, **asked)
        model = conversation.described
        _check_model(options, model.model)
        yield one_line(
            f"{model.spoken_of} drafts for {domain.name}, {options.dura_llm}: {options.sentence}",
            _LINE,
        )
        drafting: Drafting | RoleDrafting
        if basis is not None:
            drafting = RoleDrafting(conversation, options.rounds, options.role, basis)
        elif warns_of:
            drafting = MonitorDrafting(
                conversation, suite, (), options.rounds, requirement=warns_of
            )
        else:
            runs = recorded_traces(options.traces) if options.traces else suite.recorded()
            yield f"judged on {counted(len(runs), 'recorded run')}"
            seeding = Seeding(options.mutants, options.cases, options.runs)
            drafting = Drafting(conversation, suite, runs, options.rounds, seeding)
        yield from _lines(drafting)
    finally:
        session.close()
    if not drafting.passed:
        yield "no draft passed"
        return 1
    if isinstance(drafting, RoleDrafting):
        text = drafting.text()
    else:
        kind = ABOUT_MONITORS if warns_of else ABOUT
        text = draft_file(drafting.passed, options.sentence, model.model, model.fingerprint, kind)
    if options.output is None:
        yield from text.splitlines()
    else:
        options.output.write_text(text, "utf-8")
        yield f"written: {options.output}, {counted(len(drafting.passed), 'draft')}, not reviewed"
    return 0


def _lines(drafting: Drafting | RoleDrafting) -> Iterator[str]:
    """Yield what became of each draft, below the number of its round."""
    last = 0
    for outcome in drafting.outcomes():
        if outcome.round != last:
            last = outcome.round
            yield f"round {last}:"
        word = "kept: " if outcome.kept else "refused: "
        text = f"{outcome.name} {word}{outcome.text}" if outcome.name else outcome.text
        yield f"  {one_line(text, _LINE)}"


def _check(options: argparse.Namespace) -> None:
    problem = None
    named = options.output and options.output.name
    if options.output is not None and (options.output.exists() or options.output.is_symlink()):
        problem = "-o", str(options.output), "a new file", "name another one, or remove it"
    elif options.output is not None and not options.output.parent.is_dir():
        folder = str(options.output.parent)
        problem = "-o", folder, "a file in a folder that exists", "make the folder first"
    elif not options.sentence.strip():
        problem = "SENTENCE", "nothing", "what is required, in your words", "write a sentence"
    elif options.role and not (named and re.fullmatch(r"draft_\w+(?<!_test)\.py", named, re.ASCII)):
        expected = (
            "a new file draft_*.py: Python and pytest load files of other names by themselves"
        )
        problem = "-o", named or "no file", expected, "name such a file"
    if options.role and (options.warns_of or options.traces):
        given = "--warns-of" if options.warns_of else "--traces"
        problem = given, f"{given} beside --role", "one of them", "leave one of them out"
    if options.warns_of and options.traces:
        found = ", ".join(map(str, options.traces))
        expected = "no traces: monitors are run anew, without recovery"
        problem = "--traces", found, expected, "leave out --traces or --warns-of"
    for name in ("rounds", "cases", "runs"):
        if getattr(options, name) < 1:
            problem = f"--{name}", getattr(options, name), "a whole number above 0", "correct it"
    if problem is not None:
        key, found, expected, remedy = problem
        raise ConfigurationError(
            f"{key} cannot be used", key=key, found=found, expected=expected, remedy=remedy
        )


def _check_model(options: argparse.Namespace, answers: str) -> None:
    """Refuse a cassette in which another model answers than ``--llm`` names."""
    from pytest_dura.llm.endpoint import MODEL

    named = environment_of(options.llm).get(MODEL, answers)
    if options.dura_llm == "replay" and named != answers:
        raise ConfigurationError(
            "the cassette holds answers of another model",
            file=str(options.dura_cassette),
            key="--llm",
            found=one_line(named),
            expected=one_line(answers),
            remedy="leave --llm out, or name the cassette of this model",
        )


def _session(options: argparse.Namespace) -> ModelSession:
    """Make the session that asks the model, live or through a cassette."""
    from pytest_dura.llm.session import ModelSession

    environ = {**os.environ, **environment_of(options.llm)}
    cassette = None if options.dura_llm == "live" else options.dura_cassette
    return ModelSession(options.dura_llm, cassette, environ=environ)


def environment_of(llm: str | None) -> dict[str, str]:
    """Return what ``--llm`` sets of the environment; nothing without it.

    Raises:
        ConfigurationError: If it names no server and model.
    """
    from pytest_dura.llm.endpoint import MODEL, URL

    if llm is None:
        return {}
    split = re.fullmatch(r"(https?://.+?/v\d+)/(.+)|(https?://.+)/([^/]+)", llm)
    if split is None:
        raise ConfigurationError(
            "--llm names no server and model",
            key="--llm",
            found=one_line(llm),
            expected="such as http://127.0.0.1:11434/v1/llama3.1:8b",
            remedy="write the base URL, a slash, and the model's name",
        )
    return {URL: split[1] or split[3], MODEL: split[2] or split[4]}
