"""LanguageModels: who answers components that ask a language model, and how often.

Every pytest run loads this module. Nothing else of ``pytest_dura.llm`` is imported unless an option
names a mode, or a component did it.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.guests import AtOnce, Guest, ListedCase, Session
from pytest_dura.llm.options import LlmOptions
from pytest_dura.llm.stated import LIVE, stated_model

if TYPE_CHECKING:
    from pytest_dura.core.episode import EpisodeSpec
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.evidence.files import InputFiles
    from pytest_dura.evidence.model import Fact
    from pytest_dura.llm.servers import ModelDescription
    from pytest_dura.llm.session import ModelSession

_MOST_MODELS = 3
"""Models of a cassette that the header names."""
_OUTCOMES = ("asked", "repeated", "reused", "injected", "missed")
_CAUSE = "unavailable: "
"""What the counts of calls that ended so begin with, by cause."""
_TOKENS = "tokens: "
"""What the counts of tokens begin with, by what they were for."""
_SESSION_MODULE = "pytest_dura.llm.session"
_USE = "asks a language model"


def _module() -> Any:
    """Return the module of model sessions, where something of this process has imported it."""
    return sys.modules.get(_SESSION_MODULE)


def _in_use() -> ModelSession | None:
    """Return the model session that is in use by now, if any is."""
    module = _module()
    session: ModelSession | None = None if module is None else module.in_use()
    return session


def _answers(roles: Iterable[RoleSpec]) -> str | None:
    """What answers the language models that some roles call; ``None`` if they call none.

    A cassette that is replayed is as much an input as a scenario. Of a server the resolved
    parameters of the role say all that is known.
    """
    calls_models = any(isinstance(role.params.get("model"), str) for role in roles)
    if _module() is None or not calls_models:
        return None
    session = _in_use()
    if session is None or session.cassette is None or session.mode != "replay":
        return "live" if session is None else str(session.mode)
    file = session.cassette.file
    stat = file.stat()
    return f"replay {_file_digest(file, stat.st_size, stat.st_mtime_ns)}"


# Each episode has an address, and a cassette may have many megabytes.
@lru_cache(maxsize=4)
def _file_digest(file: Path, _size: int, _changed: int) -> str:
    """SHA-256 of a file, read once as long as it stays as it is."""
    state = hashlib.sha256()
    with file.open("rb") as opened:
        while chunk := opened.read(1 << 20):
            state.update(chunk)
    return state.hexdigest()


class LanguageModels(Guest):
    """Language models that the components of one process ask.

    Args:
        session: The session.
        options: Its options of language models.
        sent: What the controller sent to a worker of pytest-xdist.
    """

    options = LlmOptions

    def __init__(self, session: Session, options: LlmOptions, sent: Mapping[str, Any]) -> None:
        super().__init__(session, options, sent)
        self._has_begun = False
        self._previous: ModelSession | None = None
        self._used: dict[tuple[Any, ...], Counter[str]] = {}
        self._latest: dict[tuple[str, str], tuple[Any, ...]] = {}
        self._counted: Counter[tuple[str, str, str]] = Counter()
        self._unsent: set[tuple[Any, ...]] = set()
        self._replayed: list[ModelDescription] = []

    @classmethod
    def reason_to_stay(cls, role: RoleSpec) -> str:
        """Keep a component where its exchanges are counted and recorded."""
        return "" if stated_model(role) is None else _USE

    @classmethod
    def inputs_of(cls, roles: Iterable[RoleSpec]) -> Mapping[str, str]:
        """Name the cassette, or that a server answers."""
        answers = _answers(roles)
        return {} if answers is None else {"answers of language models": answers}

    @classmethod
    def reason_to_differ(cls, roles: Iterable[RoleSpec]) -> str:
        """Say whether a server answers, which may answer otherwise."""
        answers = _answers(roles)
        live = answers is not None and not answers.startswith("replay ")
        return LIVE if live else ""

    @classmethod
    def uses(cls) -> Mapping[str, int]:
        """Count the requests of this process, however they were answered."""
        session = _in_use()
        return {_USE: 0 if session is None else sum(session.counts.values())}

    def to_worker(self) -> Mapping[str, Any]:
        """Return the id of the session, and what was probed of servers."""
        sent: dict[str, Any] = {"session": self._name}
        session = _in_use()
        if self.given.cassette is None and session is not None:
            # Each worker's own probe might differ, and so describe another component.
            sent["described"] = [description.to_json() for description in session.descriptions]
        return sent

    def begin(self) -> None:
        """Open the cassette, and let nothing of an earlier session of this process answer.

        Raises:
            ConfigurationError: If the cassette cannot be used.
        """
        if self._has_begun:
            return
        self._has_begun = True
        self._previous = self._activate(None)
        self._name = self.sent.get("session") or os.urandom(8).hex()
        options = self.given
        described = self.sent.get("described", ())
        is_special = (
            options.concurrency > 1 or options.limits is not None or options.retries is not None
        )
        if options.mode != "live":
            session = self._session(options.mode, options.cassette, scrub=self.session.redact)
            self._replayed = session.replayed
            self._activate(session)
        elif described or is_special:
            session = self._session()
            session.know(described)
            self._activate(session)

    @property
    def _meter_file(self) -> Path:
        """File in which the processes of the session add up what they ask."""
        return Path(tempfile.gettempdir()) / f"pytest-dura-meter-{self._name}"

    def reason_to_end(self) -> str:
        """Say why this process asks no server any more."""
        session = _in_use()
        ended_by = "" if session is None else session.ended_by
        return f"{ended_by}; --dura-resume goes on" if ended_by else ""

    def owner(self) -> str:
        """Keep a cassette in this process."""
        return (
            "" if self.given.mode == "live" else "a cassette of a language model is of this process"
        )

    def at_once(self) -> AtOnce:
        """Return how many requests are made at once."""
        return AtOnce(self.given.concurrency, "requests to language models")

    def in_replay(self) -> Mapping[str, str | None]:
        """Let the cassette answer a replay, whatever the mode of this session."""
        return {} if self.given.cassette is None else {"--dura-llm": "replay"}

    @classmethod
    def replayed(cls, values: Mapping[str, str]) -> Mapping[str, str]:
        """Let the cassette that a session recorded or replayed answer."""
        mode, cassette = LlmOptions.mode.key, LlmOptions.cassette.key
        if values.get(mode) not in ("record", "replay"):
            return {}
        return {mode: "replay", **{key: values[key] for key in (cassette,) if key in values}}

    def listed(self, cases: Iterable[ListedCase]) -> Iterable[str]:
        """Count the requests of the planned cases at most."""
        from pytest_dura.llm.request_counts import request_lines

        return request_lines(cases, self.given.mode)

    def add_inputs(self, inputs: InputFiles) -> None:
        """Add the cassette that is replayed."""
        if self.given.mode == "replay" and self.given.cassette is not None:
            inputs.add("cassette", self.given.cassette)

    def requests(self) -> int | None:
        """Return how many requests this process has made to servers; ``None`` for none so far."""
        session = _in_use()
        counts = {} if session is None else dict(session.counts)
        made = (number for (*_, how), number in counts.items() if how in ("asked", "repeated"))
        return sum(made) or None

    def stop(self) -> None:
        """Let no thread that is still under way ask or record anything any more."""
        session = _in_use()
        if self._has_begun and session is not None:
            session.stop()

    def _session(self, *given: Any, **named: Any) -> ModelSession:
        """A model session with the id, the retries and the limits of this session."""
        from pytest_dura.llm.session import ModelSession
        from pytest_dura.llm.usage import Meter

        limits = self.given.limits
        return ModelSession(
            *given,
            session=self._name,
            retries=self.given.retries,
            concurrency=self.given.concurrency,
            meter=None if limits is None else Meter(limits, self._meter_file),
            **named,
        )

    def end(self) -> None:
        """Restore the model session that was in use before."""
        if not self._has_begun:
            return
        self._has_begun = False
        session = self._activate(self._previous)
        if session is not None:
            session.close()
        if not self.session.is_worker:
            with suppress(OSError):  # what is left in the folder for such files does no harm
                self._meter_file.unlink(missing_ok=True)

    def _activate(self, session: ModelSession | None) -> ModelSession | None:
        """Put a model session to use; returns the one that was in use."""
        module = _module()
        before: ModelSession | None = None if module is None else module.use(session)
        return before

    def first_lines(self) -> list[str]:
        """Header line on the recorded models, where a cassette answers."""
        if self.given.cassette is None or not self._replayed:
            return []
        from pytest_dura.provenance import recorded_path

        models = [f"{model.spoken_of}, recorded {model.created[:10]}" for model in self._replayed]
        if len(models) > _MOST_MODELS:
            models[_MOST_MODELS:] = [f"and {len(models) - _MOST_MODELS} more models"]
        file = recorded_path(self.given.cassette, self.session.root)
        return [f"answers replayed from {file}: {'; '.join(models)}"]

    def header(self) -> list[str]:
        """Header line for each model that is known by now."""
        session = _in_use()
        lines, time = [], ""
        if budgets := self.session.time_budgets:
            least, most = f"{budgets[0]:g}", f"{budgets[-1]:g}"
            seconds = least if least == most else f"{least} to {most}"
            time = f", at most {seconds} s for a decision"
        for description in [] if session is None else session.descriptions:
            capabilities = description.capabilities
            enforcement = " (enforced)" if capabilities.get("enforced") else " (not enforced)"
            level = str(capabilities.get("structured", "unknown"))
            abilities = ", ".join(
                f"{name} {'yes' if capabilities.get(name) else 'no'}" for name in ("vision", "seed")
            )
            if capabilities.get("tokens", "max_tokens") != "max_tokens" or not capabilities.get(
                "temperature", True
            ):
                abilities += f", {capabilities.get('words', {}).get('fields', '')}"
            lines.append(
                f"language model {description.model} at {description.base_url} "
                f"({self.given.mode}), structured output {level}"
                f"{'' if level == 'none' else enforcement}, {abilities}{time}"
                f"{f'; {description.about}' if description.about else ''}"
            )
        return lines

    def prepare(self, spec: EpisodeSpec) -> None:
        """Probe the servers of an episode that is run again, outside the component's time.

        Raises:
            ConfigurationError: If one does not answer.
        """
        models = [stated[0] for role in spec.roles.values() if (stated := stated_model(role))]
        if models and self.given.mode != "replay":
            from pytest_dura.llm.session import current

            for model in models:
                current().describe(model)

    def replay_warning(self) -> list[str]:
        """Warning, if a server was asked in this process, that its answers may differ."""
        session = _in_use()
        counts = {} if session is None else session.counts
        if not any(count for (*_, outcome), count in counts.items() if outcome == "asked"):
            return []
        advice = "--dura-llm=replay repeats what --dura-llm=record kept"
        return [f"  a language model was asked anew and may have answered otherwise; {advice}"]

    def used(self, spec: EpisodeSpec) -> None:
        """Note the models that the resolved specs of a used episode state."""
        if _module() is None:
            return
        for role in spec.roles.values():
            stated = stated_model(role)
            if stated is not None:
                key = (role.label, *stated, role.params.get("prompts"))
                self._register(key)
                self._latest[stated] = key

    def take(self) -> list[Fact]:
        """Return the models that are new or were asked since the last call."""
        session = _in_use()
        if session is None:
            return []
        counts = Counter(session.counts)
        for (model, fingerprint, kind), count in Counter(session.tokens).items():
            counts[model, fingerprint, _TOKENS + kind] = count
        for (model, fingerprint, outcome), count in (counts - self._counted).items():
            key = self._latest.get((model, fingerprint), (None, model, fingerprint, None))
            self._register(key)
            self._used[key][outcome] += count
            self._unsent.add(key)
        self._counted = counts
        entries = [self._entry(session, key) for key in sorted(self._unsent, key=str)]
        self._unsent.clear()
        return entries

    @contextmanager
    def uncounted(self) -> Iterator[None]:
        """Context of a repetition, whose requests enter no count."""
        module = _module()
        with nullcontext() if module is None else module.uncounted():
            yield

    def _register(self, key: tuple[Any, ...]) -> None:
        if key not in self._used:
            self._used[key] = Counter()
            self._unsent.add(key)

    def _entry(self, session: ModelSession, key: tuple[Any, ...]) -> Fact:
        from pytest_dura.llm.record import UsedModel
        from pytest_dura.llm.usage import Tokens

        component, model, fingerprint, prompts = key
        known, counts = session.known(model, fingerprint), self._used[key]
        outcomes: dict[str, Any] = {outcome: counts[outcome] for outcome in _OUTCOMES}
        for how in ("asked", "reused"):
            kinds = ("prompt", "completion", "uncounted")
            outcomes[f"{how}_tokens"] = Tokens(
                *(counts[f"{_TOKENS}{how} {kind}"] for kind in kinds)
            )
        used = UsedModel(
            component=component,
            model=model,
            about="" if known is None else known.about,
            base_url=None if known is None else known.base_url,
            mode=session.mode,
            fingerprint=fingerprint,
            capabilities=None if known is None else dict(known.capabilities),
            prompts=prompts if isinstance(prompts, str) else None,
            unavailable={
                counted.removeprefix(_CAUSE): count
                for counted, count in sorted(counts.items())
                if counted.startswith(_CAUSE)
            },
            **outcomes,
        )
        return used.fact(self.session.worker_name)

    def take_last(self, inputs: InputFiles) -> list[Fact]:
        """Return the cassette as it is now."""
        session, file = _in_use(), self.given.cassette
        if file is None or session is None or session.cassette is None:
            return []
        from pytest_dura.core.codec import encode
        from pytest_dura.evidence.files import sha256_of
        from pytest_dura.evidence.model import Fact
        from pytest_dura.llm.record import CASSETTE, NAME, Cassette
        from pytest_dura.provenance import recorded_path

        sha256 = sha256_of(file)
        if session.mode == "record":
            # Recording has changed the file.
            inputs.add("cassette", file, sha256)
        cassette = Cassette(recorded_path(file, self.session.root), sha256, len(session.cassette))
        return [Fact(NAME, CASSETTE, 0, encode(cassette))]
