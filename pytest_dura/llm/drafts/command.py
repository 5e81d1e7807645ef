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
    from pytest_dura.llm.drafts.asking import Conversation, Draft
    from pytest_dura.llm.drafts.checks import RecordedRun, Shown
    from pytest_dura.llm.drafts.earning import Suite
    from pytest_dura.llm.drafts.files import Passed
    from pytest_dura.llm.session import ModelSession

SUMMARY = (
    "let a language model draft requirements from a sentence, and keep those that catch something"
)
_LINE = 1000
_VIOLATED = (
    "the suite's own component violates it in each scenario that decides it, so that nothing shows "
    "what it catches"
)


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
    from pytest_dura.llm.drafts.asking import Conversation
    from pytest_dura.llm.drafts.checks import recorded_traces
    from pytest_dura.llm.drafts.earning import Suite, domain_named
    from pytest_dura.llm.drafts.files import draft_file

    _check(options)
    domain = domain_named(options.domain)
    suite = Suite(Runner.of(*options.suite), domain, options.scenario)
    session = _session(options)
    try:
        conversation = Conversation(session, domain, options.sentence)
        model = conversation.described
        yield one_line(
            f"{model.spoken_of} drafts for {domain.name}, {options.dura_llm}: {options.sentence}",
            _LINE,
        )
        runs = recorded_traces(options.traces) if options.traces else suite.recorded()
        yield f"judged on {counted(len(runs), 'recorded run')}"
        drafting = _Drafting(conversation, suite, runs, options)
        yield from drafting.lines()
    finally:
        session.close()
    passed = drafting.passed
    if not passed:
        yield "no draft passed"
        return 1
    text = draft_file(passed, options.sentence, model.model, model.fingerprint)
    if options.output is None:
        yield from text.splitlines()
    else:
        options.output.write_text(text, "utf-8")
        yield f"written: {options.output}, {counted(len(passed), 'draft')}, not reviewed"
    return 0


def _check(options: argparse.Namespace) -> None:
    problem = None
    if options.output is not None and options.output.exists():
        problem = "-o", str(options.output), "a new file", "name another one, or remove it"
    elif not options.sentence.strip():
        problem = "SENTENCE", "nothing", "what is required, in your words", "write a sentence"
    for name in ("rounds", "cases", "runs"):
        if getattr(options, name) < 1:
            problem = f"--{name}", getattr(options, name), "a whole number above 0", "correct it"
    if problem is not None:
        key, found, expected, remedy = problem
        raise ConfigurationError(
            f"{key} cannot be used", key=key, found=found, expected=expected, remedy=remedy
        )


def _session(options: argparse.Namespace) -> ModelSession:
    """Make the session that asks the model, live or through a cassette."""
    from pytest_dura.llm.endpoint import MODEL, URL
    from pytest_dura.llm.session import ModelSession

    environ = dict(os.environ)
    if options.llm is not None:
        split = re.fullmatch(r"(https?://.+?/v\d+)/(.+)|(https?://.+)/([^/]+)", options.llm)
        if split is None:
            raise ConfigurationError(
                "--llm names no server and model",
                key="--llm",
                found=one_line(options.llm),
                expected="such as http://127.0.0.1:11434/v1/llama3.1:8b",
                remedy="write the base URL, a slash, and the model's name",
            )
        environ |= {URL: split[1] or split[3], MODEL: split[2] or split[4]}
    cassette = None if options.dura_llm == "live" else options.dura_cassette
    return ModelSession(options.dura_llm, cassette, environ=environ)


class _Drafting:
    """Rounds of drafts: what is refused goes back to the model."""

    def __init__(
        self,
        conversation: Conversation,
        suite: Suite,
        runs: list[RecordedRun],
        options: argparse.Namespace,
    ) -> None:
        self.conversation, self.suite, self.runs = conversation, suite, runs
        self.options = options
        self.passed: list[Passed] = []

    def lines(self) -> Iterator[str]:
        """Yield what became of each draft, round by round."""
        for number in range(1, self.options.rounds + 1):
            digest = self.conversation.prompt_digest
            reading, answer = self.conversation.ask()
            yield f"round {number}:"
            refused: list[str] = []
            if not reading.answered:
                refused.append(f"the answer is none ({reading.outcome}): {reading.detail}")
                yield "  " + one_line(refused[0], _LINE)
                if reading.outcome in ("unavailable", "timeout"):  # the model is not to blame
                    return
            else:
                for name, reason in self._round(reading.content["requirements"], digest):
                    yield "  " + one_line(f"{name} {reason}", _LINE)
                    if reason.startswith("refused: "):
                        refused.append(f"{name}: {reason.removeprefix('refused: ')}")
                if not reading.content["requirements"]:
                    refused.append("the answer has no requirement")
                    yield f"  {refused[0]}"
            if not refused:
                return
            self.conversation.send_back(answer, refused)

    def _round(self, entries: list[dict[str, object]], digest: str) -> Iterator[tuple[str, str]]:
        """Yield the id of each draft, and what became of it."""
        from pytest_dura.llm.drafts.asking import Draft
        from pytest_dura.llm.drafts.checks import refusal_of_text, shown_on

        taken = self.suite.taken | dict.fromkeys(
            (each.requirement.id for each in self.passed), "an earlier draft"
        )
        sound: dict[str, tuple[Draft, Shown]] = {}
        for entry in entries:
            draft = Draft.of(entry)
            name = draft.requirement.id
            reason = refusal_of_text(draft, self.suite.domain, taken)
            taken[name] = "another draft"
            if not reason:
                shown = shown_on(draft, self.runs)
                reason = shown.refusal
            if reason:
                yield name or "(no id)", f"refused: {reason}"
            else:
                sound[name] = draft, shown
        yield from self._earning(sound, digest)

    def _earning(
        self, sound: dict[str, tuple[Draft, Shown]], digest: str
    ) -> Iterator[tuple[str, str]]:
        """Yield what became of drafts that judge something: of those that catch nothing, why."""
        from pytest_dura.llm.drafts.files import Passed

        seeded = self.options.mutants != "none"
        usable: dict[str, Draft] = {}
        where: set[str] = set()
        first = [case.scenario.name for case in self.suite.cases]
        for name, (draft, shown) in sound.items():
            places = shown.supported if shown.scenarios else first
            if seeded and not places:
                yield name, f"refused: {_VIOLATED}"
                continue
            usable[name] = draft
            where.update(places[: self.options.cases])
        earned = (
            self.suite.earned(usable, where, self.options.mutants, self.options.runs)
            if seeded and usable
            else {}
        )
        for name, draft in usable.items():
            shown = sound[name][1]
            text = earned[name].text if seeded else "no defect was seeded"
            if seeded and not earned[name].alone:
                yield name, f"refused: it {text}"
                continue
            self.passed.append(Passed(draft.requirement, [*shown.scenarios], text, digest))
            alone = f" ({', '.join(earned[name].alone)})" if seeded else ""
            judged = f"satisfied in {shown.satisfied} and violated in {shown.violated}"
            kept = f"kept: {draft.requirement.check}; {judged} of {shown.runs} runs; {text}{alone}"
            yield name, kept
