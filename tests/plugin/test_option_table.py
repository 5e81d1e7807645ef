"""What follows from a row of the table of options, and from nothing else."""

from __future__ import annotations

import pytest
from recorded_logs import Drive

from pytest_dura.execution import address_of
from pytest_dura.options import Option, whole_number
from pytest_dura.plugin.commands.option_reference import reference_page
from pytest_dura.plugin.options import Options, option_rows, send_options
from pytest_dura.plugin.session.session import session_of

FLAGS = [row for row in option_rows() if row.flag is not None]
BESIDE = {
    "baseline": ["--dura-baseline=dura-evidence"],
    "cassette": ["--dura-llm=replay"],
    "fail_worse": ["--dura-baseline=dura-evidence"],
    "episode_timeout": ["--dura-executor=processes"],
    "episode_memory": ["--dura-executor=processes"],
    "globs": ["--dura-log-mapping=mapping.yaml"],
    "mapping": ["--dura-log=drives/*.mcap"],
    "judging": ["--dura-log=drives/*.mcap", "--dura-log-mapping=mapping.yaml"],
}
"""What an option does not go without."""
SELECT = "--dura-select=intersection/ghost-obstacle"
OF_MODELS = {"--dura-llm", "--dura-cassette"}
"""They change the episodes of components that ask a language model."""


def arguments(row):
    given = f"{row.flag}={row.example}" if not row.is_switch else row.flag
    return [*BESIDE.get(row.name, []), given]


def session(project, *given):
    config = project.pytester.parseconfigure(*given, "--dura-scenarios=builtin", SELECT)
    return session_of(config)


def addresses(planning):
    planning.make_plan()
    task = planning.runner.task
    return {address_of(task(planned.case, 1)).name for planned in planning.plan}


@pytest.fixture
def elsewhere(project):
    """What the options of other places name is there."""
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    project.write("my/scenarios/other.yaml", text.replace("corridor/tight", "other/tight"))
    (project.path / "drives").mkdir()
    Drive(0).mcap(project.path / "drives" / "0.mcap")
    project.write("mapping.yaml", "signals: {gap: {topic: /radar, field: range}}")
    requirement = "{id: LOG-1, text: a gap, kind: safety, check: always (gap > 3)}"
    project.write("requirements.yaml", f"requirements: [{requirement}]")
    return project


def test_the_help_of_a_session_is_that_of_the_table(project):
    text = " ".join(project.run("--help").stdout.str().split())
    for row in option_rows():
        assert row.full_help in text
        assert row.key.removeprefix("ini ") in text


def test_the_house_has_few_options_each_described_by_one_sentence():
    flags = [row for row in Options.rows() if row.flag is not None]
    assert len(flags) <= 30
    for row in option_rows():
        assert ". " not in row.help, row.key
        assert not row.help.endswith("."), row.key


def test_the_table_says_which_options_make_other_episodes_and_which_commands_repeat_them(elsewhere):
    plain = addresses(session(elsewhere))
    for row in FLAGS:
        planning = session(elsewhere, *arguments(row))
        for command in ("rerun", "replay"):
            repeated = arguments(row)[-1] in planning.options.repeated(command)
            assert repeated is (command in row.repeated_in), row.flag
        same = bool(plain & addresses(planning))
        assert same is (not row.changes_episodes or row.flag in OF_MODELS), row.flag


@pytest.fixture
def extra(monkeypatch):
    """A row beside those of the package, which a session knows as soon as it is in the table."""
    row = Option(
        "--dura-extra",
        "count",
        whole_number(at_least=1),
        ini="dura_extra",
        default="3",
        metavar="N",
        example="5",
        repeated_in=("rerun",),
        no_shard="it counts",
        no_shard_for="8",
    )
    row.__set_name__(Options, "extra")
    monkeypatch.setattr(Options, "extra", row, raising=False)
    return row


def test_a_row_is_an_option_a_setting_and_a_line_of_the_page(project, extra):
    assert session(project).options.extra == 3
    project.write("pytest.ini", "[pytest]\npythonpath = .\ndura_extra = 4\n")
    assert session(project).options.extra == 4
    assert session(project).options.repeated("rerun") == []
    options = session(project, "--dura-extra=5").options
    assert options.extra == 5
    assert options.repeated("rerun") == ["--dura-extra=5"]
    assert options.compared_in_shards() == {"--dura-extra": '"5"'}
    page = reference_page()
    assert "| `--dura-extra=N` | Count. For example `--dura-extra=5`. | 3 |" in page
    assert "| `dura_extra` | Count. | 3 | `--dura-extra` |" in page
    assert "| `--dura-extra` |  |  | rerun | no `8`: it counts |" in page
    with pytest.raises(pytest.UsageError, match="--dura-extra takes a whole number"):
        _ = session(project, "--dura-extra=0").options
    assert session(project, "--dura-extra=5", "--dura-shard=1/2").options.extra == 5
    with pytest.raises(pytest.UsageError, match="--dura-shard and --dura-extra exclude each other"):
        _ = session(project, "--dura-extra=8", "--dura-shard=1/2").options


def test_a_worker_has_the_paths_of_the_controller(project):
    options = session(project, "--dura-evidence=out", "--dura-llm=record").options
    sent = options.paths_for_workers()
    assert sent == {
        "--dura-evidence": str(project.path / "out"),
        "--dura-cassette": str(project.path / "dura-cassette.sqlite"),
    }
    config = project.pytester.parseconfigure("--dura-evidence=elsewhere", "--dura-llm=record")
    config.workerinput = {}
    send_options(options, config.workerinput)
    assert Options(config).paths_for_workers() == sent


def test_the_setting_of_repeatable_episodes_is_recorded(project):
    project.scenarios("-o", "dura_require_repeatable=true", select="corridor/free")
    assert project.evidence().require_repeatable is True
