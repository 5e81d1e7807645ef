"""Registries: decorators and entry points, and the errors for what cannot be used."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import pytest

from pytest_dura import DOMAINS, FAULT_TYPES, FORMATS, ROLES, SIMULATORS, ConfigurationError
from pytest_dura.core import RoleSpec
from pytest_dura.core.messages import MESSAGES
from pytest_dura.core.registry import Registry
from pytest_dura.core.trust import Places, check_registered, use_places
from pytest_dura.domains import Domain, domain_of, names_of_role, role_spec, simulator_spec
from pytest_dura.execution.executors import EXECUTORS
from pytest_dura.faults import (
    Channel,
    FaultEffect,
    NumberFault,
    check_target,
    fault_effect,
    parse_fault,
)
from pytest_dura.faults.model import KIND_MEANINGS, kind_meaning

REGISTRIES = (DOMAINS, SIMULATORS, ROLES, FAULT_TYPES, EXECUTORS, FORMATS)
GROUPS = {registry.group: registry for registry in REGISTRIES}


class Sway(NumberFault):
    """A number that sways."""

    @classmethod
    def example(cls) -> dict[str, Any]:
        return {"activation": {"at": 1.0}}

    def changed(self, value: Any, moment: Any) -> Any:
        return value + 1.0


@pytest.fixture
def numbers() -> Registry[float]:
    return Registry("pytest_dura.test_numbers", "number", lambda v: isinstance(v, float), "a float")


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Writes a package as pip would have installed it."""

    def add(package: str, group: str, code: str = "", **names: str) -> Path:
        site = tmp_path / package / "site-packages"
        info = site / f"{package}-1.dist-info"
        info.mkdir(parents=True)
        info.joinpath("METADATA").write_text(f"Name: {package}\nVersion: 1\n")
        lines = "".join(f"{name} = {path}\n" for name, path in names.items())
        info.joinpath("entry_points.txt").write_text(f"[{group}]\n{lines}")
        site.joinpath(f"{package}.py").write_text(code)
        monkeypatch.syspath_prepend(str(site))
        return site

    return add


@pytest.mark.of_guest
@pytest.mark.parametrize("registry", REGISTRIES, ids=lambda registry: registry.group)
def test_what_the_package_registers_can_be_loaded(registry: Registry[Any]) -> None:
    assert registry
    assert list(registry.problems()) == []
    for name, value in registry.items():
        assert registry.fits(value)
        assert registry.is_ours(name)
        assert registry.path(name).startswith("pytest_dura.")


def test_formats_are_registered_under_the_names_of_their_files() -> None:
    assert {name: vars(form)["FILE"] for name, form in FORMATS.items()} == {n: n for n in FORMATS}


def test_loading_the_plugin_reads_no_entry_points_of_ours() -> None:
    code = "import pytest_dura.plugin, sys; print('pytest_dura.core.registry' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.split() == ["False"]


def test_an_object_is_registered_by_a_decorator(numbers: Registry[float]) -> None:
    assert numbers.register("half")(0.5) == 0.5
    assert numbers["half"] == 0.5
    assert list(numbers) == ["half"]
    assert numbers.entry("half").provider == f"the module {__name__}"


def test_an_entry_point_is_imported_when_it_is_used(numbers: Registry[float], install: Any) -> None:
    install("two", numbers.group, "VALUE = 2.0", two="two:VALUE")
    assert "two" in numbers
    assert "two" not in sys.modules
    assert numbers["two"] == 2.0
    assert numbers.name_of("two:VALUE") == "two"
    del sys.modules["two"]


def test_two_packages_of_a_name_are_both_in_the_error(
    numbers: Registry[float], install: Any
) -> None:
    install("first", numbers.group, three="first:VALUE", other="first:VALUE")
    install("second", numbers.group, three="second:VALUE")
    with pytest.raises(ConfigurationError, match="two packages register the number 'three'") as no:
        numbers.path("three")
    assert "first 1 (first:VALUE)" in str(no.value)
    assert "second 1 (second:VALUE)" in str(no.value)
    assert [error.problem for error in numbers.problems()] == [no.value.problem]
    assert numbers.path("other") == "first:VALUE"
    with pytest.raises(ConfigurationError, match=f"the module {__name__}.*second 1|first 1"):
        numbers.register("other")(3.0)


@pytest.mark.parametrize(
    "code, problem",
    [
        ("raise SystemExit(3)", "the number 'bad' of bad 1 cannot be loaded: .*SystemExit"),
        ("import no_such_module", "the number 'bad' of bad 1 cannot be loaded: .*no_such_module"),
        ("", "the number 'bad' of bad 1 cannot be loaded: .*VALUE"),
        ("VALUE = 'x'", "the number 'bad' of bad 1 is none"),
    ],
)
def test_a_broken_package_is_one_error_when_it_is_used(
    numbers: Registry[float], install: Any, code: str, problem: str
) -> None:
    install("bad", numbers.group, code, bad="bad:VALUE", good="json:loads")
    assert list(numbers) == ["bad", "good"]
    with pytest.raises(ConfigurationError, match=problem) as caught:
        numbers["bad"]
    assert caught.value.remedy is not None
    assert "bad 1" in caught.value.remedy
    sys.modules.pop("bad", None)


def test_python_s_own_modules_are_not_registered(numbers: Registry[float], install: Any) -> None:
    install("sly", numbers.group, pi="math:pi")
    with pytest.raises(ConfigurationError, match="standard library"):
        numbers["pi"]


def test_a_name_that_means_something_else_is_refused(install: Any) -> None:
    install("rude", "pytest_dura.faults", none="rude:X", catalogue="rude:X")
    install("forger", "pytest_dura.reports", **{"evidence.json": "forger", "../up.txt": "forger"})
    assert "none" not in FAULT_TYPES
    assert "../up.txt" not in FORMATS
    assert "evidence.json" not in list(FORMATS)
    problems = [str(error) for error in (*FAULT_TYPES.problems(), *FORMATS.problems())]
    assert len(problems) == 4
    assert all("under a name that is not allowed" in problem for problem in problems)
    with pytest.raises(ConfigurationError, match="not allowed"):
        FORMATS.register("manifest.json")(json)


@pytest.mark.of_guest
def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match="unknown simulator 'drivng'") as caught:
        simulator_spec("drivng", {})
    assert caught.value.remedy == "did you mean 'driving'?"


def test_without_its_metadata_the_package_has_to_be_installed_again(
    numbers: Registry[float],
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        numbers["one"]
    assert "install pytest-dura again" in str(caught.value)


class Muddled(FaultEffect):
    """An intent that is said otherwise."""

    acts_on: ClassVar[str] = "intent"
    default_target: ClassVar[str | None] = "intent"

    def apply(self, memory: Any, value: Any, moment: Any) -> Any:
        return f"not {value}"


def test_faults_of_a_package_act_on_the_message_that_it_registers(install: Any) -> None:
    install(
        "intents",
        "pytest_dura.messages",
        "INTENT = 'what others are shown'",
        intent="intents:INTENT",
    )
    channels = {"gap": Channel("numbers", ("metres",))}
    given = {"type": f"{__name__}:Muddled", "activation": {"at": 1.0}}
    intended = parse_fault({**given, "id": "muddled", "target": "intent"})
    assert check_target(intended, fault_effect(intended), channels).kind == "message"
    for target in ("gap.metres", "gap"):
        wrong = parse_fault({**given, "id": "muddled", "target": target})
        with pytest.raises(ConfigurationError, match="it acts on what others are shown") as refused:
            check_target(wrong, fault_effect(wrong), channels)
        assert "one of intent" in str(refused.value)


def test_a_message_has_no_name_of_a_kind_of_values_and_a_kind_that_nothing_has_is_refused() -> None:
    assert MESSAGES.reserved >= {*KIND_MEANINGS}
    with pytest.raises(ConfigurationError, match="objects"):
        MESSAGES.register("objects")("what is seen")
    with pytest.raises(ConfigurationError, match="acts on 'nubmer', and no value is of") as refused:
        kind_meaning("nubmer")
    assert "did you mean 'number'?" in str(refused.value)


def test_a_fault_type_of_a_decorator_is_known_to_other_processes() -> None:
    before = dict(FAULT_TYPES._registered)
    try:
        FAULT_TYPES.register("sway")(Sway)
        given = {"type": "sway", "target": "x.y", "activation": {"at": 1.0}}
        data = parse_fault(given)
        assert parse_fault(given).id == "sway"
    finally:
        FAULT_TYPES._registered.clear()
        FAULT_TYPES._registered.update(before)
    # Where the decorator has not run, the path leads there.
    assert data.type == f"{__name__}:Sway"
    by_path = parse_fault({**given, "type": f"{__name__}:Sway", "id": "sway"})
    assert parse_fault(data.plain()) == by_path
    assert fault_effect(data) == Sway()


@pytest.mark.of_guest
def test_domains_own_what_begins_with_their_name(install: Any) -> None:
    install(
        "crane",
        "pytest_dura.simulators",
        "from pytest_dura import Domain\nCRANE = Domain('crane', roles={'generator': 'slow'})",
        **{"crane": "crane:Crane", "crane.heavy": "crane:Heavy", "lonely": "crane:Lonely"},
    )
    install("crane_domain", "pytest_dura.domains", crane="crane:CRANE")
    install(
        "crane_roles",
        "pytest_dura.roles",
        **{"crane.generator.slow": "crane:Slow", "generator.random": "crane:Random",
           "driving.generator.slow": "crane:Other"},
    )  # fmt: skip
    crane = domain_of("crane.heavy")
    assert isinstance(crane, Domain)
    assert crane == domain_of("crane") == domain_of("crane:Heavy")
    assert domain_of("lonely") is domain_of("elsewhere:Sim") is None
    injector = "pytest_dura.faults.injector:CampaignInjector"
    assert crane.default_roles == {"generator": "crane:Slow", "fault_injector": injector}
    assert crane.simulator == "crane:Crane"
    # A role without a domain is in each, and the domain's own of that name goes before it.
    assert role_spec("generator", RoleSpec("random"), crane).path == "crane:Random"
    assert role_spec("generator", RoleSpec("random"), None).path == "crane:Random"
    driving = DOMAINS["driving"].short_names["generator"]["random"]
    assert driving == "pytest_dura.driving.roles.planners:RandomPlanner"
    names = names_of_role("generator")
    assert "slow" not in names
    assert names["crane.generator.slow"] == "crane.generator.slow"
    assert names["aggressive"] == "driving.generator.aggressive"
    sys.modules.pop("crane")


def test_files_name_what_is_registered_or_the_project_s_own(install: Any) -> None:
    before = use_places(Places())
    try:
        install("silent", "something_else", x="silent:X")
        install("open", "pytest_dura.roles", **{"generator.open": "open:X"})
        check_registered("open:Other")
        check_registered("test_registry:Sway")
        check_registered("pytest_dura.driving.highway:HighwaySimulator")
        with pytest.raises(ConfigurationError, match="registers nothing for pytest-dura"):
            check_registered("silent:X")
        with pytest.raises(ConfigurationError, match="registers nothing for pytest-dura"):
            check_registered("numpy.random:Generator")
        use_places(Places(trusting=True))
        check_registered("silent:X")
    finally:
        use_places(before)
    assert "silent" not in sys.modules
