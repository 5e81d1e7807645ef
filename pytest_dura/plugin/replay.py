"""``--dura-replay``: an episode of the evidence again, and whether its digest is the same."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.overrides import defined_in_conftest

if TYPE_CHECKING:
    import pytest

    from pytest_dura.core.episode import Episode, EpisodeSpec
    from pytest_dura.core.roles import RoleSpec
    from pytest_dura.plugin.options import Options

Data = Mapping[str, Any]


def replay(config: pytest.Config, options: Options) -> int:
    """Run the episode again and return the exit code: 0 if the digests are equal, else 1.

    Raises:
        ConfigurationError: For an unknown episode, and one that cannot be built again.
    """
    from pytest_dura.core.episode import EpisodeSpec
    from pytest_dura.evidence.bundle import read_record

    record = read_record(options.evidence)
    assert options.replay is not None
    equal = True
    try:
        for told in _episodes(record, options.replay):
            spec = _with_local_roles(config, EpisodeSpec.from_json(told["spec"]))
            equal &= _show(str(told["digest"]), _run(record, spec))
    except (AttributeError, LookupError, TypeError, ValueError, ArithmeticError) as error:
        raise ConfigurationError(
            f"the record is damaged ({type(error).__name__}: {error})",
            file=str(options.evidence / "evidence.json"),
            key="--dura-replay",
            found=options.replay,
            expected="a record as pytest-dura wrote it",
            remedy="run the session again, or restore the file",
        ) from None
    return 0 if equal else 1


def _episodes(record: Data, name: str) -> list[Data]:
    """The episodes of this id: several, if it was run with several seeds or components."""
    found = [one for one in record["episodes"] if one["id"] == name]
    if found:
        return found
    known = sorted({one["id"] for one in record["episodes"]})
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.4)
    expected = ", ".join(near or known[:3]) or "an episode; this evidence has none"
    raise ConfigurationError(
        f"the evidence has no episode {name!r}",
        key="--dura-replay",
        found=name,
        expected=f"case#run, such as {expected}" if known else expected,
        remedy="name an episode of this session, or another evidence with --dura-evidence",
    )


def _run(record: Data, spec: EpisodeSpec) -> Episode:
    from pytest_dura.campaign.runner import run_episode
    from pytest_dura.requirements.judge import RequirementJudge
    from pytest_dura.requirements.model import Requirement

    judge = None
    if spec.termination.violation:
        case = {one["id"]: one for one in record["cases"]}[spec.case]
        known = {one["id"]: Requirement.from_json(one) for one in record["requirements"]}
        judge = RequirementJudge([known[name] for name in case["requirements"]])
    return run_episode(spec, judge)


def _show(digest: str, episode: Episode) -> bool:
    same = digest == episode.digest
    end = f"{episode.time[-1]:.1f} s" if episode.ticks else "no tick"
    outcome = f"{episode.termination} after {end}"
    lines = [
        f"{episode.id} ({episode.spec.component}, seed {episode.spec.seed}): {outcome}",
        f"  recorded digest {digest}",
        f"  replayed digest {episode.digest}",
        "  the same"
        if same
        else "  DIFFERENT: the code, a package or the platform has changed, "
        "or something is not deterministic",
    ]
    if episode.failure is not None:
        lines.insert(1, f"  {episode.failure}")
    print("\n".join(lines))  # noqa: T201 - it is what was asked for
    return same


def _with_local_roles(config: pytest.Config, spec: EpisodeSpec) -> EpisodeSpec:
    """The spec with classes of conftest files found where pytest has loaded them."""
    roles = {name: _local(config, role) for name, role in spec.roles.items()}
    return replace(spec, roles=roles, simulator=_local(config, spec.simulator))


def _local(config: pytest.Config, role: RoleSpec) -> RoleSpec:
    from pytest_dura.campaign.components import LocalRole

    file, _, name = role.path.rpartition(":")
    if not file.endswith("conftest.py"):
        return role
    target = defined_in_conftest(config, file, name)
    if callable(target):
        return LocalRole(role.path, target)
    raise ConfigurationError(
        f"{name} is defined in {file}, which is not loaded here",
        key="--dura-replay",
        found=role.path,
        expected="the arguments of the session, which load the same conftest files",
        remedy=f"add the folder of {file} to the command",
    )
