"""``assurance-case.gsn.yaml``: the argument as gsn2x reads it."""

from __future__ import annotations

from typing import Any

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.gsn.element import rule_problems
from pytest_dura.reports.gsn.user_argument import session_argument
from pytest_dura.reports.wording import review_text

FILE = "assurance-case.gsn.yaml"
_MODULE = "module"


def render(record: SessionRecord) -> str:
    """The file's text.

    Raises:
        ConfigurationError: If the user's argument refers to what the session does not have.
        ValueError: If the argument breaks a rule, which would be a fault of this package.
    """
    import yaml

    elements = {id_: element.to_yaml() for id_, element in session_argument(record).items()}
    problems = rule_problems(elements)
    if problems:
        raise ValueError(f"the argument breaks a rule: {problems[0]}")
    module = {
        "name": "assurance-case",
        "brief": f"By pytest-dura, {review_text(record)}"
        + (": nothing here is asserted." if record.review is None else "."),
    }
    return yaml.dump(
        {_MODULE: module, **elements},
        Dumper=_dumper(),
        sort_keys=False,
        allow_unicode=True,
        width=96,
    )


def _dumper() -> type[Any]:
    import yaml

    class Dumper(yaml.SafeDumper):
        """Plain YAML without anchors, in which every text is text for YAML 1.2 too."""

        def ignore_aliases(self, data: Any) -> bool:
            return data is not None

    def text(dumper: Any, data: str) -> Any:
        # PyYAML follows YAML 1.1, for which 1e3 and 0o7 are text without quotes.
        style = '"' if data[:1] in "+-.0123456789" else None
        return dumper.represent_scalar("tag:yaml.org,2002:str", data, style=style)

    Dumper.add_representer(str, text)
    return Dumper
