"""SessionRoles: which roles the episodes of a session run with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.overrides import conftest_defining, root_conftest_with

if TYPE_CHECKING:
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.plugin.session import DuraSession


class SessionRoles:
    """What options, role fixtures and the domain's defaults come to.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self._defaults: dict[str, RoleSpec] = {}

    def default(self, role: str) -> RoleSpec:
        """What a role's fixture returns unless it is overridden; the same object at every call."""
        if role not in self._defaults:
            from pytest_dura.campaign.components import generator_option
            from pytest_dura.campaign.domains import DOMAINS
            from pytest_dura.core.role_spec import RoleSpec

            driving, option = DOMAINS["driving"], self.session.options.generator
            if role == "simulator":
                spec = RoleSpec(driving.simulator)
            elif role == "generator" and option is not None:
                spec = generator_option(option)
            else:
                spec = RoleSpec(driving.roles[role])
            self._defaults[role] = spec
        return self._defaults[role]

    def chosen(self) -> dict[str, RoleSpec | None]:
        """The roles that options put in place of the scenarios' and domains' own."""
        if self.session.options.generator is None:
            return {}
        return {"generator": self.default("generator")}

    def use(self, given: dict[str, Any]) -> None:
        """Let the bench run what the role fixtures of an item returned.

        Raises:
            ConfigurationError: For something that is no such role, and for a generator that is
                given twice.
        """
        from pytest_dura.campaign.components import given_role

        overridden = {
            role: given_role(role, value, conftest_defining(self.session.config, value))
            for role, value in given.items()
            if value is not self.default(role)
        }
        if "generator" in overridden and self.session.options.generator is not None:
            raise _given_twice("a fixture")
        self.session.bench.simulator = overridden.pop("simulator", None)
        self.session.bench.roles = self.chosen() | overridden

    def check(self) -> None:
        """Check the generator that is given.

        Raises:
            ConfigurationError: For one that cannot be used, and for one that is given twice.
        """
        if self.session.options.generator is None:
            return
        self.default("generator")
        conftest = root_conftest_with(self.session.config, "generator")
        if conftest is not None:
            raise _given_twice(f"the fixture `generator` in {conftest}")


def _given_twice(where: str) -> ConfigurationError:
    """The component under test is named twice."""
    return ConfigurationError(
        "the component under test is given twice",
        key="--dura-generator",
        found=f"--dura-generator and {where}",
        expected="one of them",
        remedy="drop the option, or the fixture",
    )
