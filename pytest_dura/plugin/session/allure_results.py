"""Items in Allure's results.

allure-pytest writes Allure's report. Labels are the markers that it reads; without its
``--alluredir`` no result is described. It maps our failures to ``failed`` by itself, since they
are those of ``pytest.fail``.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any
from urllib.parse import quote
from uuid import uuid4

import pytest

from pytest_dura.core.codec import encode, fields_as_data
from pytest_dura.evidence.text import markdown, name, one_line, visible
from pytest_dura.plugin.context import replay_command
from pytest_dura.plugin.items.markers import marked_requirements
from pytest_dura.plugin.items.outcomes import ItemJudged, ItemResult, episode_of, target_of
from pytest_dura.plugin.session.item_cards import card_of, command_of, draws_of, verdict_of
from pytest_dura.reports.document import Card
from pytest_dura.reports.pens.items import card_markdown

if TYPE_CHECKING:
    from pytest_dura.campaign.events import EventStream
    from pytest_dura.core.episode import Episode
    from pytest_dura.evidence.traces import Trace
    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.requirements.episode_verdicts import EpisodeVerdict
    from pytest_dura.requirements.model import Requirement


def subscribe(context: SessionContext, events: EventStream) -> None:
    """Report what items come to, where Allure writes a report.

    Args:
        context: The session's context.
        events: On which the plugin emits :class:`ItemJudged`.
    """
    if context.config.getoption("allure_report_dir", None):
        events.subscribe(ItemJudged, partial(_report_item, context))


def redact_results(config: pytest.Config, redact: Callable[[Any], Any]) -> None:
    """Take secrets out of what Allure writes: of steps and fixtures, too, whose errors it reads.

    Args:
        config: Of the session.
        redact: Takes secrets out of a text.
    """
    from allure_commons import hookimpl, plugin_manager

    class Redacting:
        @hookimpl(tryfirst=True)
        def report_result(self, result: Any) -> None:
            _redact_entry(result, redact)

        @hookimpl(tryfirst=True)
        def report_container(self, container: Any) -> None:
            _redact_entry(container, redact)

    redacting = Redacting()
    plugin_manager.register(redacting)
    config.add_cleanup(lambda: plugin_manager.unregister(redacting))


def _redact_entry(entry: Any, redact: Callable[[Any], Any]) -> None:
    for attribute, value in vars(entry).items():
        if isinstance(value, str):
            setattr(entry, attribute, redact(value))
        for part in value if isinstance(value, list) else [value]:
            if hasattr(type(part), "__attrs_attrs__"):
                _redact_entry(part, redact)


_EPIC = "dependability"
_LINK_TYPE = "requirement"
"""``--allure-link-pattern=requirement:https://example.org/{}`` makes links of ids."""
_SEVERITIES = {
    "safety": "blocker",
    "security": "critical",
    "recovery": "critical",
    "performance": "normal",
}
_WORST_FIRST = ("blocker", "critical", "normal")
_SELECTIONS = ("epics", "features", "stories", "ids", "severities", "labels")
_OWN_CHOICE = ("epic", "feature", "story", "severity")


def is_used(config: pytest.Config) -> bool:
    """Whether Allure reports this session, or selects tests by their labels."""
    options = ("allure_report_dir", *(f"allure_{name}" for name in _SELECTIONS))
    return any(config.getoption(option, None) for option in options)


def mark_item(context: SessionContext, item: pytest.Item) -> None:
    """Give an item its labels and links; the test's own ones take precedence."""
    own = {marker.kwargs.get("label_type") for marker in item.iter_markers("allure_label")}
    requirements = list(
        {requirement.id: requirement for requirement in marked_requirements(context, item)}.values()
    )
    target = target_of(item)
    for kind, value in _labels(requirements, None if target is None else target.case):
        if not (kind in _OWN_CHOICE and kind in own):
            item.add_marker(pytest.mark.allure_label(value, label_type=kind))
    for requirement in requirements:
        url = _requirement_url(context.config, requirement.id)
        item.add_marker(
            pytest.mark.allure_link(url, link_type=_LINK_TYPE, name=name(requirement.id))
        )


def _labels(requirements: Sequence[Requirement], case: Case | None) -> Iterator[tuple[str, str]]:
    yield "epic", _EPIC
    if case is not None:
        yield "feature", name(case.scenario.name)
        yield "story", name(_story_of(case))
    kinds = list(dict.fromkeys(requirement.kind for requirement in requirements))
    if kinds:
        yield "severity", min(map(_SEVERITIES.__getitem__, kinds), key=_WORST_FIRST.index)
    for kind in kinds:
        yield "tag", kind
    for requirement in requirements:
        yield "requirement", name(requirement.id)


def _story_of(case: Case) -> str:
    faults = " + ".join(fault.id for fault in case.faults) or "no faults"
    return ", ".join([faults, *(f"without {role}" for role in case.without)])


def _requirement_url(config: pytest.Config, requirement: str) -> str:
    """Build an address by the user's pattern; an id is never an address by itself."""
    quoted = quote(requirement, safe="", errors="replace")
    patterns: dict[str, Any] = dict(config.getoption("allure_link_pattern", None) or [])
    return str(patterns.get(_LINK_TYPE, "{}")).replace("{}", quoted)


LARGEST = 2_000_000
"""Bytes of an attachment."""
_ASKED_OF_EPISODE = ("assertion", "case", "planned", "at_most", "confidence")
"""What an attached verdict on an episode says of the question."""
_COUNTEREXAMPLES = 100
"""Counterexamples in the attached verdict."""


def _report_item(context: SessionContext, event: ItemJudged) -> None:
    """Add an item's results to the open Allure result, which is not written yet."""
    from allure_commons import plugin_manager

    item, results = event.item, event.results
    allure = plugin_manager.hook
    components = dict.fromkeys(
        one_line(result.component, 200) for result in results if result.component
    )
    allure.add_label(label_type="component", labels=tuple(components))
    for result in results:
        prefix = f"{one_line(result.requirement.id, 100)}: " if len(results) > 1 else ""
        parameters = _parameters(context, result)
        draws = draws_of(context, result.case)
        for parameter, value in ({**parameters, "draws": draws} if draws else parameters).items():
            # Allure's history tells tests apart by parameters: results must not be among them.
            allure.add_parameter(name=prefix + parameter, value=value, excluded=True, mode=None)
    cards = [card_of(context, event, result) for result in results]
    description = _description(context, event, cards)
    if description:
        allure.add_description(test_description=description)
    if results and not hasattr(getattr(item, "function", None), "__allure_display_name__"):
        allure.add_title(test_title=_title(item, results))
    for result in results:
        verdict = result.verdict or result.judged
        if verdict is not None:
            data = encode(verdict)
            if result.judgement is not None:
                asked = encode(result.judgement)
                data |= {key: asked[key] for key in _ASKED_OF_EPISODE}
            text = _verdict_json(context.redact(data))
            _attach(text, f"verdict {result.requirement.id}", "JSON")
    if context.options.evidence_level != "summary":
        _show_worst(context, item, results, cards)


def _title(item: pytest.Item, results: Sequence[ItemResult]) -> str:
    """What is asked for, after the case of a scenario item or the name of a test."""
    subject = item.planned.case.id if hasattr(item, "planned") else item.name
    asked = "; ".join(f"{each.requirement.id} {each.requirement.text}" for each in results)
    return one_line(f"{subject}: {asked}", 200)


def _parameters(context: SessionContext, result: ItemResult) -> dict[str, Any]:
    verdict, judgement = result.verdict, result.judgement
    parameters: dict[str, Any] = {
        "case": result.case.id if result.case else verdict and verdict.case,
        "component": result.component,
        "verdict": result.status,
    }
    if verdict is not None:
        bound = verdict.bound
        parameters |= {
            "planned": verdict.planned,
            "valid": verdict.episodes,
            "violations": verdict.violations,
            "bound": bound.upper,
            "confidence": None if bound.upper is None else bound.confidence,
            "at most": bound.at_most,
        }
    elif judgement is not None:
        parameters |= {"planned": judgement.planned, "at most": judgement.at_most}
    parameters["base seed"] = context.options.seed
    return {
        name: one_line(value, 200) if isinstance(value, str) else value
        for name, value in parameters.items()
        if value is not None
    }


def _description(context: SessionContext, event: ItemJudged, cards: Sequence[Card | None]) -> str:
    """Write Markdown: the test's docstring, then each requirement with source and card."""
    from pytest_dura.reports.verdicts import reading_sentences

    item = event.item
    given = item.get_closest_marker("allure_description")
    if given:
        own = given.args[0]
    elif hasattr(item, "planned"):  # its function is ours, and says nothing of the user's
        own = None
    else:
        own = item.function.__doc__ if hasattr(item, "function") else None
    parts = [inspect.cleandoc(own)] if own else []
    for result, card in zip(event.results, cards, strict=True):
        requirement = result.requirement
        parts.append(f"**{markdown(requirement.id)}** {markdown(requirement.text, 2000)}")
        reason = result.verdict.reason if result.verdict else result.judged and result.judged.detail
        for heading, text in (
            ("Source", requirement.source),
            ("Why this bound", requirement.reason),
            ("Verdict", f"{result.status or 'none'}. {reason or ''}"),
        ):
            if text:
                parts.append(f"{heading}: {markdown(text, 2000)}")
        own = verdict_of(event, result) if result.judgement is not None else None
        parts += [markdown(text, 2000) for text in (reading_sentences(own) if own else ())]
        if card is not None:
            parts += card_markdown(card, command_of(context))
    return "\n\n".join(parts)


def _show_worst(
    context: SessionContext,
    item: pytest.Item,
    results: Sequence[ItemResult],
    cards: Sequence[Card | None],
) -> None:
    """Show one episode: the worst violation, else one that does not count, else the first."""
    from pytest_dura.evidence.traces import Trace

    result = next((result for result in results if result.status == "violated"), None)
    result = result or next(iter(results), None)
    episode = episode_of(item) or (None if result is None else _worst_episode(context, result))
    if episode is None:
        return
    # Attachments leave the machine as the bundle does.
    redact = context.redact
    judged = None if result is None else _judged_on(result, episode)
    if judged is not None:
        judged = replace(judged, detail=redact(judged.detail))
    kind, problem = "Sample", None
    if result is not None and _is_counterexample(result, episode):
        kind = "Counterexample"
        card = cards[results.index(result)]
        if card is not None:
            problem = f"{card.headline} {card.entries[0].label}: {card.entries[0].text}"
    elif episode.validity != "valid":
        kind = episode.validity.capitalize()
        problem = episode.failure or episode.invalid_reason
    title = one_line(redact(f"{kind} {episode.id}, seed {episode.spec.seed}"), 200)
    replay = one_line(redact(replay_command(context, episode.id)))
    parameters = {"replay": replay, "digest": episode.digest}
    trace = Trace.of(episode).without_secrets(redact)
    with _step(title, parameters, None if problem is None else one_line(redact(problem))):
        if problem is not None:
            _attach_picture(episode, trace, judged, one_line(redact(problem)))
        _show_loop(episode, trace, judged, _check_of(result))
        _attach_all(episode, trace, judged, _check_of(result))


def _attach_picture(
    episode: Episode, trace: Trace, judged: EpisodeVerdict | None, problem: str
) -> None:
    """Attach the scene at the violation, or else at the end; nothing where there is no scene."""
    from pytest_dura.reports.scene import frame_svg

    if not episode.ticks:
        return
    known = None if judged is None else judged.time
    picture = frame_svg(trace, float(episode.time[-1]) if known is None else known, label=problem)
    if picture:
        _attach(str(picture), "picture", "SVG")


def _is_counterexample(result: ItemResult, episode: Episode) -> bool:
    if result.judged is not None:
        return result.status == "violated"
    examples = result.verdict.counterexamples if result.verdict else ()
    return any(example.episode == episode.id for example in examples)


def _check_of(result: ItemResult | None) -> str:
    if result is None:
        return ""
    own = result.judgement and result.judgement.assertion
    if own and own.failed and not own.by_check:
        return ""  # it held: what failed is an assertion of the test
    return (result.verdict and result.verdict.check) or str(result.requirement.check)


def _worst_episode(context: SessionContext, result: ItemResult) -> Episode | None:
    verdict = result.verdict
    if verdict is None or result.case is None or not verdict.run:
        return None
    shown = verdict.counterexamples[0] if verdict.counterexamples else verdict.first_uncounted
    run = int(shown.episode.rpartition("#")[2]) if shown else 0
    return context.runner.fetch(result.case, run)


def _judged_on(result: ItemResult, episode: Episode) -> EpisodeVerdict | None:
    """Judge this episode by the requirement: from the item's outcome, or by the check."""
    from pytest_dura.core.errors import ConfigurationError
    from pytest_dura.requirements.episode_verdicts import judge_episode

    if result.judged is not None:
        return result.judged
    try:
        return judge_episode(result.requirement, episode, _check_of(result))
    except ConfigurationError:  # a measure of pairs, or a function inside a test
        return None


def _show_loop(episode: Episode, trace: Trace, judged: EpisodeVerdict | None, check: str) -> None:
    """Show the loop's six steps at the tick of the violation."""
    from pytest_dura.reports.episode_view import decision_at, loop_steps

    tick = decision_at(trace, None if judged is None else judged.time)
    if tick is None:
        return
    steps = loop_steps(trace, tick, _signals(episode, check))
    for step in steps:
        verdict = {}
        if step is steps[-1] and judged is not None:
            line = one_line(f"{judged.verdict}: {judged.detail}")
            verdict = {one_line(judged.requirement, 100): line}
        with _step(step.name, {**step.details, **verdict}):
            pass


def _signals(episode: Episode, check: str) -> list[str]:
    """Name the signals that the check reads, or else the first ones of the truth."""
    from pytest_dura.reports.episode_view import formula_of

    formula = formula_of(check)
    names = (
        [] if formula is None else [signal.removeprefix("percept.") for signal in formula.signals]
    )
    read = [signal for signal in dict.fromkeys(names) if signal in episode.signals]
    return (
        read
        or [signal for signal in sorted(episode.signals) if not signal.startswith("percept.")][:4]
    )


def _attach_all(episode: Episode, trace: Trace, judged: EpisodeVerdict | None, check: str) -> None:
    from pytest_dura.evidence.mcap import trace_bytes
    from pytest_dura.reports.episode_view import signals_csv
    from pytest_dura.reports.html.player import player_page

    verdicts = [] if judged is None else [{**fields_as_data(judged), "check": check}]
    _attach(_plot(episode, judged, check), "plot", "SVG")
    _attach(player_page(trace, verdicts, episode.described_measures), "animation", "HTML")
    _attach(signals_csv(trace), "signals", "CSV")
    _attach(trace_bytes(trace, verdicts), "trace", "application/octet-stream", "mcap")


def _plot(episode: Episode, judged: EpisodeVerdict | None, check: str) -> str:
    from pytest_dura.reports.episode_view import verdict_plot

    text = "" if judged is None else f"{judged.requirement}: {judged.verdict}"
    at = None if judged is None else judged.time
    return verdict_plot(episode, check, text, at, _signals(episode, check))


def _verdict_json(shown: dict[str, Any]) -> str:
    examples = shown.get("counterexamples", ())
    if len(examples) > _COUNTEREXAMPLES:
        shown["counterexamples"] = examples[:_COUNTEREXAMPLES]
        shown["counterexamples_left_out"] = len(examples) - _COUNTEREXAMPLES
    return json.dumps(_bounded(shown), indent=1, allow_nan=False) + "\n"


def _bounded(value: Any) -> Any:
    if isinstance(value, str):
        return visible(value)
    if isinstance(value, Mapping):
        return {visible(str(name)): _bounded(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_bounded(entry) for entry in value]
    return value


def _attach(body: str | bytes, name: str, kind: str, extension: str | None = None) -> None:
    """Attach what is small enough, and a note in place of what is not."""
    import allure

    size = len(body.encode()) if isinstance(body, str) else len(body)
    name = one_line(name, 200)
    if size > LARGEST:
        note = f"{size} bytes are left out: an attachment has at most {LARGEST}.\n"
        allure.attach(note, f"{name} (left out)", allure.attachment_type.TEXT)
        return
    known = getattr(allure.attachment_type, kind, kind)
    allure.attach(body, name, known, extension)


@contextmanager
def _step(title: str, parameters: Mapping[str, str], problem: str | None = None) -> Iterator[None]:
    """Context of a step with its parameters; with a problem it fails."""
    from allure_commons import plugin_manager

    step, failure = str(uuid4()), None if problem is None else AssertionError(problem)
    plugin_manager.hook.start_step(uuid=step, title=title, params=dict(parameters))
    try:
        yield
    finally:
        kind = None if failure is None else type(failure)
        plugin_manager.hook.stop_step(uuid=step, exc_type=kind, exc_val=failure, exc_tb=None)
