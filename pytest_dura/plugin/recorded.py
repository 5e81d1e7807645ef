"""Episodes of the evidence, found again: what they were run from, and by which requirements."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.overrides import defined_in_conftest

if TYPE_CHECKING:
    import pytest

    from pytest_dura.core.episode import Episode, EpisodeSpec
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.plugin.options import Options
    from pytest_dura.requirements.model import Requirement

Data = Mapping[str, Any]


@dataclass(frozen=True)
class Recorded:
    """One episode of a record.

    Args:
        spec: What it was run from, with classes of conftest files where pytest has loaded them.
        digest: As it was recorded.
        requirements: Those of its case.
        violated: Ids of those whose verdict names it as a counterexample.
        planned: Whether it is one of its case's runs; another one of that id has a seed by hand.
        trace: Where its trace is, as the record says: ``{file, sha256, bytes}``; if one was kept.
        faults: What became of each of its faults.
    """

    spec: EpisodeSpec
    digest: str
    requirements: tuple[Requirement, ...]
    violated: tuple[str, ...]
    planned: bool
    trace: Data | None
    faults: tuple[Data, ...]

    def run(self, spec: EpisodeSpec | None = None, *, recorded: bool = False) -> Episode:
        """The episode again, or one of another spec that ends as this one would.

        Args:
            spec: The other one.
            recorded: Whether to keep what a viewer shows of it.
        """
        from pytest_dura.campaign.episodes.task import run_episode
        from pytest_dura.requirements.judge import RequirementJudge

        end = self.spec.termination
        judge = RequirementJudge(self.requirements) if end.violation or end.decided else None
        return run_episode(spec or self.spec, judge, recorded=recorded)


def recorded_episodes(
    config: pytest.Config, options: Options, name: str, option: str
) -> tuple[Data, list[Recorded]]:
    """The record, and its episodes of this id: several, with several seeds or components.

    Args:
        config: Of the session, for what conftest files define.
        options: Where the evidence is.
        name: ``case#run``.
        option: That named the episode, for messages.

    Raises:
        ConfigurationError: For an unknown episode, a damaged record, and an episode that cannot be
            built again.
    """
    from pytest_dura.evidence.bundle.directory import read_record

    record = read_record(options.evidence)
    _check_whole(options.evidence, option)
    with damage_told(options, name, option):
        return record, [_found(config, record, one, option) for one in _named(record, name, option)]


def _check_whole(evidence: Path, option: str) -> None:
    """Refuse a bundle that its manifest does not hold for: it names what is imported and run.

    Raises:
        ConfigurationError: With the first difference.
    """
    from pytest_dura.evidence.bundle.manifest import manifest_problems

    problems = list(manifest_problems(evidence))
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise ConfigurationError(
            f"this bundle is not as it was written: {problems[0]}{more}",
            file=str(evidence / "evidence.json"),
            key=option,
            found=len(problems),
            expected="a bundle that agrees with its manifest.json",
            remedy="run `python -m pytest_dura verify` on it, restore its files, or run the "
            "session again",
        )


@contextmanager
def damage_told(options: Options, name: str, option: str) -> Iterator[None]:
    """What a record makes impossible that is not as it was written, as one error.

    Raises:
        ConfigurationError: In place of whatever reading the record, or running what it says, met.
    """
    try:
        yield
    except (AttributeError, LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise ConfigurationError(
            f"the record is damaged ({type(error).__name__}: {error})",
            file=str(options.evidence / "evidence.json"),
            key=option,
            found=name,
            expected="a record as pytest-dura wrote it",
            remedy="run the session again, or restore the file",
        ) from None


def _named(record: Data, name: str, option: str) -> list[Data]:
    found = [one for one in record["episodes"] if one["id"] == name]
    if found:
        return found
    known = sorted({one["id"] for one in record["episodes"]})
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.4)
    expected = ", ".join(near or known[:3]) or "an episode; this evidence has none"
    raise ConfigurationError(
        f"the evidence has no episode {name!r}",
        key=option,
        found=name,
        expected=f"case#run, such as {expected}" if known else expected,
        remedy="name an episode of this session, or another evidence with --dura-evidence",
    )


def _found(config: pytest.Config, record: Data, episode: Data, option: str) -> Recorded:
    from pytest_dura.core.episode import EpisodeSpec
    from pytest_dura.evidence.redaction.redactor import holds_redaction
    from pytest_dura.requirements.model import Requirement

    if holds_redaction(episode["spec"]):
        raise ConfigurationError(
            f"the episode {episode['id']!r} cannot be run again: what it was run from held a "
            "secret, which is not in the evidence",
            key=option,
            found=episode["id"],
            expected="an episode whose spec is recorded whole",
            remedy="let the component read the secret from the environment, not from a parameter",
        )
    spec = EpisodeSpec.from_json(episode["spec"])
    roles = {name: _local(config, role, option) for name, role in spec.roles.items()}
    spec = replace(spec, roles=roles, simulator=_local(config, spec.simulator, option))
    case = {(one["id"], one["component"]): one for one in record["cases"]}
    known = {one["id"]: Requirement.from_json(one) for one in record["requirements"]}
    names = case[episode["case"], episode["component"]]["requirements"]
    violated = [
        verdict["requirement"]
        for verdict in record["verdicts"]
        for one in verdict["counterexamples"]
        if one["episode"] == episode["id"] and verdict["component"] == episode["component"]
    ]
    return Recorded(
        spec,
        str(episode["digest"]),
        tuple(known[name] for name in names),
        tuple(dict.fromkeys(violated)),
        bool(episode["planned"]),
        None if episode["trace"] is None else dict(episode["trace"]),
        tuple(dict(fault) for fault in episode["faults"]),
    )


def _local(config: pytest.Config, role: RoleSpec, option: str) -> RoleSpec:
    from pytest_dura.campaign.components import LocalRole

    file, _, name = role.path.rpartition(":")
    if not file.endswith("conftest.py"):
        return role
    target = defined_in_conftest(config, file, name)
    if callable(target):
        return LocalRole(role.path, target, role.params)
    raise ConfigurationError(
        f"{name} is defined in {file}, which is not loaded here",
        key=option,
        found=role.path,
        expected="the arguments of the session, which load the same conftest files",
        remedy=f"add the folder of {file} to the command",
    )
