"""Prompts of real episodes, and percepts that a fault may have left behind.

``python tests/support/prompt_views.py`` writes the golden files of the rendered prompts anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pytest_dura import Orchestrator, RoleSpec, Runner, Termination
from pytest_dura.core import GeneratorView, Proposal, RoleContext
from pytest_dura.driving import RuleBased
from pytest_dura.faults import parse_fault
from pytest_dura.library import load_library
from pytest_dura.llm import Prompt, driving_prompt, driving_templates

GOLDEN = Path(__file__).parents[1] / "unit" / "llm" / "golden"


class Asked(RuleBased):
    """The rule-based planner, which notes the prompts that a language model would have got."""

    def __init__(self, ticks: Sequence[int], images: Sequence[str] = ()) -> None:
        super().__init__()
        self._ticks, self._images = ticks, images
        self.prompts: dict[int, Prompt] = {}

    def reset(self, context: RoleContext) -> None:
        """Forget the prompts."""
        super().reset(context)
        self.prompts = {}

    def propose(self, view: GeneratorView) -> Proposal:
        """As the rule-based planner does."""
        if view.index in self._ticks:
            past = [view.past[index] for index in range(0, len(view.past), 10)][-2:]
            prompt = driving_prompt(view, past, images=self._images)
            self.prompts[view.index] = view.transmit("prompt", prompt)
        return super().propose(view)


def prompts_of(
    case: str,
    *ticks: int,
    run: int = 0,
    faults: Sequence[Mapping[str, Any]] = (),
    images: Sequence[str] = (),
) -> dict[int, Prompt]:
    """The prompts at some ticks of a run of a built-in scenario, with more faults."""
    asked = Asked(ticks, images)
    bench = Runner(
        lambda: load_library([]),
        roles={"generator": RoleSpec("prompt_views:Asked", instance=asked)},
    )
    spec = bench.case(case).spec(run, 1, bench.roles)

    end = Termination((max(ticks) + 1) * spec.time_step)
    spec = replace(spec, faults=(*spec.faults, *map(parse_fault, faults)), termination=end)
    Orchestrator.build(spec).run(spec)
    return asked.prompts


SIGN = {"type": "prompt-text", "activation": {"at": 1.0}, "duration": 10.0}


def golden() -> dict[str, str]:
    """Name of each golden file, and what stands in it."""
    episodes = {
        "congested": prompts_of("intersection/congested", 0, 60, 130, run=3),
        "ghost-and-text": prompts_of("intersection/ghost-obstacle", 0, 25, 50, faults=[SIGN]),
    }
    shown = {
        f"{name}-{tick}": one for name, found in episodes.items() for tick, one in found.items()
    }
    files = {}
    for wording in ("", "paraphrased"):
        end = f"-{wording}.txt" if wording else ".txt"
        for name, prompt in shown.items():
            *opening, last = driving_templates().messages(replace(prompt, wording=wording))
            files[name + end] = last.text + "\n"
            files["opening" + end] = "\n".join(f"[{one.role}]\n{one.text}\n" for one in opening)
    return files


if __name__ == "__main__":
    for file, text in golden().items():
        (GOLDEN / file).write_text(text, "utf-8")
