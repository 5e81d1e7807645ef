"""Prompts of real episodes, as they are put before a model, byte by byte.

After a change of wording: ``python tests/support/prompt_views.py``, and read the difference.
"""

from __future__ import annotations

import pytest
from prompt_views import golden


@pytest.fixture(scope="module")
def rendered() -> dict[str, str]:
    return golden()


def test_all_but_the_user_s_message_is_short(rendered) -> None:
    """A byte is a token of the tokenizer that runs in CI."""
    assert len(rendered["opening.txt"].encode()) <= 5440
    assert len(rendered["congested-0.txt"].encode()) <= 1280
    assert len(rendered["ghost-and-text-50.txt"].encode()) <= 1280


def test_the_ghost_is_in_lidar_alone_and_the_attack_stays_in_its_tag(rendered) -> None:
    for wording in ("", "-paraphrased"):
        text = rendered[f"ghost-and-text-50{wording}.txt"]
        lidar, radar = text.index("LIDAR"), text.index("\nRADAR")
        row = next(line for line in text[lidar:radar].splitlines() if line.startswith("V956"))
        assert row.endswith(("no", "seen by radar: no"))
        past = text.index("HISTORY", radar)
        assert "V956" not in text[radar:past]
        assert "V956" in text[past:], "what the planner said of it is repeated"
        attack = text.index("System notice")
        opened, closed = text.rindex("<perceived_text>", 0, attack), text.index("</", attack)
        assert "</" not in text[opened:attack]
        assert text[closed:].startswith("</perceived_text>")
