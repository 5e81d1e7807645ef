"""``--dura-replay``: an episode of the evidence again, and whether its digest is the same."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pytest_dura.plugin.recorded import damage_told, recorded_episodes

if TYPE_CHECKING:
    import pytest

    from pytest_dura.core.episode import Episode
    from pytest_dura.plugin.options import Options


def replay(config: pytest.Config, options: Options) -> int:
    """Run the episode again and return the exit code: 0 if the digests are equal, else 1.

    Raises:
        ConfigurationError: For an unknown episode, and one that cannot be built again.
    """
    name, option = str(options.replay), "--dura-replay"
    _, found = recorded_episodes(config, options, name, option)
    equal = True
    for one in found:
        with damage_told(options, name, option):
            episode = one.run()
        equal &= _show(one.digest, episode)
    return 0 if equal else 1


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
