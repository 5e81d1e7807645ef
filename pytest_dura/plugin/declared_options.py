"""The command-line options and ini settings, as they are declared."""

from __future__ import annotations

import pytest

DEFAULT_SEED = 0
DEFAULT_EVIDENCE = "dura-evidence"
DEFAULT_LEVEL = "violations"
DEFAULT_PROGRESS_INTERVAL = "30"
DEFAULT_ROLE_TIMEOUT = 60.0
DEFAULT_CASSETTE = "dura-cassette.sqlite"


def add_options(parser: pytest.Parser) -> None:
    """Declare everything that can be set from outside."""
    group = parser.getgroup("dura", "dependability of AI-enabled cyber-physical systems")
    add = group.addoption
    add(
        "--dura-scenarios",
        action="store_true",
        help="run the built-in scenarios, and those of the ini setting dura_scenario_paths",
    )
    add(
        "--dura-path",
        action="append",
        default=[],
        metavar="DIR",
        help="another directory with scenario and requirement files (repeatable)",
    )
    add(
        "--dura-select",
        action="append",
        default=[],
        metavar="GLOB",
        help="run only scenario cases whose name matches (repeatable)",
    )
    add(
        "--dura-list",
        action="store_true",
        help="list scenarios, faults, requirements and roles, and what would run; run nothing",
    )
    add(
        "--dura-generator",
        metavar="NAME",
        help="the component under test: a short name such as rule_based, or package.module:Name",
    )
    add(
        "--dura-faults",
        action="append",
        default=[],
        metavar="FAULTS",
        help="fault campaigns instead of the scenarios' own, separated by commas: none, a fault, "
        "fault+fault, catalogue, a glob of fault types, or a YAML file with a list (repeatable)",
    )
    add("--dura-runs", metavar="N", help="episodes per case, instead of what is planned")
    add(
        "--dura-seed",
        metavar="N",
        help=f"base seed, from which every episode's seed follows (default: {DEFAULT_SEED})",
    )
    add(
        "--dura-time-budget",
        metavar="SECONDS",
        help="what the component has for one proposal, instead of what the scenarios say",
    )
    add(
        "--dura-executor",
        metavar="EXECUTOR",
        help="who simulates: in-process, processes or processes:N on this machine, or the workers "
        "of a Dask cluster, dask://HOST:PORT (default: in-process)",
    )
    add(
        "--dura-role-timeout",
        metavar="SECONDS",
        help="what the simulator, and each role but the component, has for one call before its "
        f"episode is given up (default: {DEFAULT_ROLE_TIMEOUT:g})",
    )
    add(
        "--dura-episode-timeout",
        metavar="SECONDS",
        help="what an episode may take in another process (--dura-executor), beside all time "
        "budgets of its component, before that process is ended (default: 3600)",
    )
    add(
        "--dura-shard",
        metavar="K/N",
        help="run the K-th of N parts of the session; `python -m pytest_dura merge` joins their "
        "evidence, and gates on the whole",
    )
    add(
        "--dura-end",
        choices=("decided", "complete"),
        help="end each episode once every requirement of its case is decided, or run it whole, "
        "instead of what the scenarios say",
    )
    add(
        "--dura-evidence",
        metavar="DIR",
        help=f"where the evidence goes (default: {DEFAULT_EVIDENCE})",
    )
    add(
        "--dura-resume",
        action="store_true",
        help="go on with the session that the evidence directory is of, which was interrupted, or "
        "lost a process: its episodes are taken over, as far as nothing that they rest on has "
        "changed since",
    )
    add(
        "--dura-reuse",
        metavar="DIR",
        help="keep episodes in this directory, and take over what earlier sessions left there, as "
        "far as nothing that they rest on has changed since",
    )
    add(
        "--dura-evidence-level",
        choices=("summary", "violations", "all"),
        default=None,
        help="which episodes leave a trace in the evidence: none, those that violate a requirement "
        f"and samples, or all (default: {DEFAULT_LEVEL})",
    )
    add(
        "--dura-replay",
        metavar="EPISODE",
        help="run an episode of the evidence again (case#run) and compare the digests",
    )
    add(
        "--dura-reduce",
        metavar="EPISODE",
        help="find the smallest set of faults with which an episode of the evidence (case#run) "
        "still violates its requirement; --dura-runs limits the runs (default: 100)",
    )
    add(
        "--dura-trust-code",
        action="store_true",
        help="let a bundle, or a scenario or fault file from outside the project, name code that "
        "lies beside it: it is imported, and runs as you",
    )
    add(
        "--dura-undecided",
        choices=("fail", "warn"),
        default="fail",
        help="what an undecided verdict does to its test: fail it, or skip it (default: fail)",
    )
    add(
        "--dura-no-twins",
        action="store_true",
        help="run no fault-free twins of episodes with faults, and so do not say which faults "
        "reached the component's proposals",
    )
    add(
        "--dura-baseline",
        metavar="PATH",
        help="compare the rates of violations with this evidence: evidence.json, or its directory",
    )
    add(
        "--dura-baseline-worse",
        choices=("fail", "warn"),
        help="what a rate that got worse than the baseline's does to the session (default: warn)",
    )
    add(
        "--dura-argument",
        metavar="FILE",
        help="your own argument on top of the generated assurance case, as gsn2x-style YAML",
    )
    add(
        "--dura-llm",
        choices=("live", "record", "replay"),
        help="who answers a component that asks a language model: its server, its server once for "
        "what is not in the cassette yet, or the cassette alone (default: live)",
    )
    add(
        "--dura-cassette",
        metavar="FILE",
        help="where exchanges with language models are recorded, and replayed from (default: "
        f"{DEFAULT_CASSETTE} in pytest's root directory)",
    )
    parser.addini(
        "dura_progress_interval",
        "seconds, at least, between lines on the progress of campaigns where there is no terminal, "
        f"or `never` (default: {DEFAULT_PROGRESS_INTERVAL})",
        default=DEFAULT_PROGRESS_INTERVAL,
    )
    parser.addini(
        "dura_secrets",
        "names of environment variables, or globs of them in letters of any case, whose values are "
        "kept out of the evidence, beside those whose names speak of secrets",
        type="args",
        default=[],
    )
    parser.addini(
        "dura_scenario_paths",
        "directories with scenario and requirement files (default: scenarios, if it exists)",
        type="paths",
        default=[],
    )
    parser.addini(
        "dura_require_repeatable",
        "whether a case fails the gate if one of its episodes, run twice in the session, comes out "
        "differently (default: false, which says so and no more)",
        type="bool",
        default=False,
    )
