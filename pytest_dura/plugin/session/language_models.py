"""LanguageModels: who answers components that ask a language model, and how often.

Nothing of ``pytest_dura.llm`` is imported unless an option names a mode, or a component did it.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.plugin.session.roles import root_conftest_with

if TYPE_CHECKING:
    from pytest_dura.core.episode import EpisodeSpec
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.evidence.lines import UsedModel
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.llm.servers import ModelDescription
    from pytest_dura.llm.session import ModelSession
    from pytest_dura.llm.usage import Meter
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.session.inputs import SessionInputs
    from pytest_dura.plugin.session.roles import SessionRoles


JsonObject = dict[str, Any]
_MOST_MODELS = 3
"""Models of a cassette that the header names."""
_OUTCOMES = ("asked", "repeated", "reused", "injected", "missed")
_CAUSE = "unavailable: "
"""What the counts of calls that ended so begin with, by cause."""
_TOKENS = "tokens: "
"""What the counts of tokens begin with, by what they were for."""
_SESSION_MODULE = "pytest_dura.llm.session"


class LanguageModels:
    """Language models that the components of one process ask.

    Args:
        context: The session's context.
        roles: The roles of the session.
    """

    def __init__(self, context: SessionContext, roles: SessionRoles) -> None:
        self.context = context
        self._roles = roles
        self._has_begun = False
        self._previous: ModelSession | None = None
        self._used: dict[tuple[Any, ...], Counter[str]] = {}
        self._latest: dict[tuple[str, str], tuple[Any, ...]] = {}
        self._counted: Counter[tuple[str, str, str]] = Counter()
        self._unsent: set[tuple[Any, ...]] = set()
        self._replayed: list[ModelDescription] = []

    def send_to_worker(self, workerinput: dict[str, Any]) -> None:
        """Add what a worker has to know to its input."""
        workerinput["dura_llm_session"] = self._name
        if self.context.options.cassette is None and self._active is not None:
            # Each worker's own probe might differ, and so describe another component.
            workerinput["dura_llm_described"] = [
                description.to_json() for description in self._active.descriptions
            ]

    def begin(self) -> None:
        """Open the cassette, and let nothing of an earlier session of this process answer.

        Raises:
            ConfigurationError: If the cassette cannot be used.
        """
        if self._has_begun:
            return
        self._has_begun = True
        self._previous = self._activate(None)
        self._name = self.context.worker_input.get("dura_llm_session") or os.urandom(8).hex()
        options = self.context.options
        described = self.context.worker_input.get("dura_llm_described", ())
        is_special = (
            options.llm_concurrency > 1
            or options.llm_limit is not None
            or options.llm_retries is not None
        )
        if options.llm != "live":
            session = self._session(options.llm, options.cassette, scrub=self.context.redact)
            self._replayed = session.replayed
            self._activate(session)
        elif described or is_special:
            session = self._session()
            session.know(described)
            self._activate(session)

    def _meter(self) -> Meter | None:
        """What all processes of the session ask of servers, if there is a limit of it."""
        limits = self.context.options.llm_limit
        if limits is None:
            return None
        from pytest_dura.llm.usage import Meter

        return Meter(limits, self._meter_file)

    @property
    def _meter_file(self) -> Path:
        """File in which the processes of the session add up what they ask."""
        return Path(tempfile.gettempdir()) / f"pytest-dura-meter-{self._name}"

    @property
    def ended_by(self) -> str:
        """Why this process asks no server any more, in words; empty while it does."""
        return "" if self._active is None else self._active.ended_by

    def requests(self) -> int | None:
        """Return how many requests this process has made to servers; ``None`` for none so far."""
        counts = {} if self._active is None else dict(self._active.counts)
        made = (number for (*_, how), number in counts.items() if how in ("asked", "repeated"))
        return sum(made) or None

    def stop(self) -> None:
        """Let no thread that is still under way ask or record anything any more."""
        if self._has_begun and self._active is not None:
            self._active.stop()

    def _session(self, *given: Any, **named: Any) -> ModelSession:
        """A model session with the id, the retries and the limits of this session."""
        from pytest_dura.llm.session import ModelSession

        return ModelSession(
            *given,
            session=self._name,
            retries=self.context.options.llm_retries,
            concurrency=self.context.options.llm_concurrency,
            meter=self._meter(),
            **named,
        )

    def __enter__(self) -> None:
        """See :meth:`begin`."""
        self.begin()

    def __exit__(self, *_: object) -> None:
        """See :meth:`end`."""
        self.end()

    def end(self) -> None:
        """Restore the model session that was in use before."""
        if not self._has_begun:
            return
        self._has_begun = False
        session = self._activate(self._previous)
        if session is not None:
            session.close()
        if not self.context.is_worker:
            with suppress(OSError):  # what is left in the folder for such files does no harm
                self._meter_file.unlink(missing_ok=True)

    def _activate(self, session: ModelSession | None) -> ModelSession | None:
        """Put a model session to use; returns the one that was in use."""
        module = sys.modules.get(_SESSION_MODULE)
        before: ModelSession | None = None if module is None else module.use(session)
        return before

    @property
    def _active(self) -> ModelSession | None:
        """Model session that is in use by now, if any is."""
        module = sys.modules.get(_SESSION_MODULE)
        in_use: ModelSession | None = None if module is None else module.in_use()
        return in_use

    def resolve_parameters(self) -> None:
        """Resolve the components that are known before anything runs, to fail early.

        Raises:
            ConfigurationError: If one cannot be settled, such as for a server that does not answer.
        """
        config = self.context.config
        if self.context.is_worker or config.option.collectonly:
            return
        for spec in self._components():
            self.context.resolver.resolve(spec)

    def _components(self) -> list[RoleSpec]:
        context = self.context
        if context.options.generator is not None:
            return [self._roles.default("generator")]
        if not context.plan or root_conftest_with(context.config, "generator") is not None:
            return []
        role_specs: list[RoleSpec] = []
        for planned in context.plan:
            spec = planned.case.roles({})["generator"]
            if spec not in role_specs:
                role_specs.append(spec)
        return role_specs

    def replayed(self) -> list[str]:
        """Header line on the recorded models, where a cassette answers."""
        if self.context.options.cassette is None or not self._replayed:
            return []
        from pytest_dura.provenance import recorded_path

        models = [f"{model.spoken_of}, recorded {model.created[:10]}" for model in self._replayed]
        if len(models) > _MOST_MODELS:
            models[_MOST_MODELS:] = [f"and {len(models) - _MOST_MODELS} more models"]
        file = recorded_path(self.context.options.cassette, self.context.config.rootpath)
        return [f"dura: answers replayed from {file}: {'; '.join(models)}"]

    def header(self) -> list[str]:
        """Header line for each model that is known by now."""
        session = self._active
        lines = []
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
                f"dura: language model {description.model} at {description.base_url} "
                f"({self.context.options.llm}), structured output {level}"
                f"{'' if level == 'none' else enforcement}, {abilities}"
                f"{f'; {description.about}' if description.about else ''}"
            )
        return lines

    def prepare(self, spec: EpisodeSpec) -> None:
        """Probe the servers of an episode that is run again, outside the component's time.

        Raises:
            ConfigurationError: If one does not answer.
        """
        from pytest_dura.execution.task import stated_model

        models = [stated[0] for role in spec.roles.values() if (stated := stated_model(role))]
        if models and self.context.options.llm != "replay":
            from pytest_dura.llm.session import current

            for model in models:
                current().describe(model)

    def replay_warning(self) -> list[str]:
        """Warning, if a server was asked in this process, that its answers may differ."""
        session = self._active
        counts = {} if session is None else session.counts
        if not any(count for (*_, outcome), count in counts.items() if outcome == "asked"):
            return []
        advice = "--dura-llm=replay repeats what --dura-llm=record kept"
        return [f"  a language model was asked anew and may have answered otherwise; {advice}"]

    def used(self, spec: EpisodeSpec) -> None:
        """Note the models that the resolved specs of a used episode state."""
        if _SESSION_MODULE not in sys.modules:
            return
        from pytest_dura.execution.task import stated_model

        for role in spec.roles.values():
            stated = stated_model(role)
            if stated is not None:
                key = (role.label, *stated, role.params.get("prompts"))
                self._register(key)
                self._latest[stated] = key

    def take(self) -> list[UsedModel]:
        """Return the models that are new or were asked since the last call."""
        session = self._active
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
        module = sys.modules.get(_SESSION_MODULE)
        with nullcontext() if module is None else module.uncounted():
            yield

    def _register(self, key: tuple[Any, ...]) -> None:
        if key not in self._used:
            self._used[key] = Counter()
            self._unsent.add(key)

    def _entry(self, session: ModelSession, key: tuple[Any, ...]) -> UsedModel:
        from pytest_dura.evidence.lines import UsedModel

        component, model, fingerprint, prompts = key
        known = session.known(model, fingerprint)
        counts = {
            "component": component,
            "model": model,
            "about": "" if known is None else known.about,
            "base_url": None if known is None else known.base_url,
            "mode": session.mode,
            "fingerprint": fingerprint,
            "capabilities": None if known is None else dict(known.capabilities),
            "prompts": prompts if isinstance(prompts, str) else None,
            **{outcome: self._used[key][outcome] for outcome in _OUTCOMES},
            **{
                f"{how}_tokens": {
                    kind: self._used[key][f"{_TOKENS}{how} {kind}"]
                    for kind in ("prompt", "completion", "uncounted")
                }
                for how in ("asked", "reused")
            },
            "unavailable": {
                counted.removeprefix(_CAUSE): count
                for counted, count in sorted(self._used[key].items())
                if counted.startswith(_CAUSE)
            },
        }
        return UsedModel(str(self.context.worker_input.get("workerid", "main")), counts)

    def completed(self, record: SessionRecord, inputs: SessionInputs) -> SessionRecord:
        """Return the record of a finished session with the cassette as it is now."""
        session, file = self._active, self.context.options.cassette
        if file is None or session is None or session.cassette is None:
            return record
        from pytest_dura.evidence.files import sha256_of
        from pytest_dura.provenance import recorded_path

        sha256 = sha256_of(file)
        if session.mode == "record":
            # Recording has changed the file.
            inputs.inputs.add("cassette", file, sha256)
        cassette = {
            "file": recorded_path(file, self.context.config.rootpath),
            "sha256": sha256,
            "exchanges": len(session.cassette),
        }
        models = [model.replace(cassette=cassette) for model in record.head.models]
        return record.changed(models=models)
