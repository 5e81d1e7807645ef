from .cases import (
    Case,
    SearchedCase,
    case_with_faults,
    expand_cases,
    make_searched_case,
    select_cases,
)
from .checks import scenario_problems
from .documents import parse_yaml, read_yaml
from .fault_campaigns import read_campaigns
from .loading import (
    Library,
    builtin_paths,
    current_library,
    load_library,
    load_scenarios,
    select_names,
    use_library,
)
from .roles import LocalRole, ParameterResolver, generator_of_option, role_of_fixture
from .scenario import Choice, Range, Scenario, replace_value, split_path

__all__ = [
    "Case",
    "Choice",
    "Library",
    "LocalRole",
    "ParameterResolver",
    "Range",
    "Scenario",
    "SearchedCase",
    "builtin_paths",
    "case_with_faults",
    "current_library",
    "expand_cases",
    "generator_of_option",
    "load_library",
    "load_scenarios",
    "make_searched_case",
    "parse_yaml",
    "read_campaigns",
    "read_yaml",
    "replace_value",
    "role_of_fixture",
    "scenario_problems",
    "select_cases",
    "select_names",
    "split_path",
    "use_library",
]
