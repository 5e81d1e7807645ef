"""What a session of somebody else pays for the plugin that he installed and does not use."""

from __future__ import annotations

import subprocess
import sys

import pytest

EXECUTOR = ""
"""Sessions that may not know the option."""

HEAVY = [
    "numpy", "highway_env", "rtamt", "pydantic", "yaml", "scipy", "gymnasium", "hypothesis",
    "jinja2", "jsonschema", "mcap", "sqlite3", "lazy_loader",
]  # fmt: skip
LIGHT = {
    "pytest_dura", "pytest_dura.guests", "pytest_dura.options",
    "pytest_dura.plugin", "pytest_dura.plugin.event_hook",
    "pytest_dura.plugin.fixtures", "pytest_dura.plugin.option_values",
    "pytest_dura.plugin.options", "pytest_dura.plugin.short_fixtures",
    "pytest_dura.plugin.waiting",
}  # fmt: skip
GUESTS = {
    "pytest_dura.driving", "pytest_dura.driving.guest",
    "pytest_dura.llm", "pytest_dura.llm.guest", "pytest_dura.llm.options",
    "pytest_dura.llm.stated",
    "pytest_dura.logs", "pytest_dura.logs.guest", "pytest_dura.logs.options",
    "pytest_dura.public_names",
    "pytest_dura.qualification", "pytest_dura.qualification.guest",
    "pytest_dura.qualification.options",
}  # fmt: skip
"""What a session reads the options of guests from."""
OTHERS = ["-p", "no:hypothesispytest", "-p", "no:allure_pytest", "-p", "no:xdist"]
PLAIN = """
import pytest

@pytest.fixture
def episode():
    return 1

@pytest.mark.requirement("of somebody else", 3)
@pytest.mark.parametrize("generator", [1])
def test_one(episode, generator):
    pass
"""


def run(code, *arguments):
    """Exit code of pytest in a process of its own, and the modules that it has imported."""
    script = f"import sys\nstatus = 0\n{code}\nprint()\nprint(int(status), *sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True
    )
    status, *modules = done.stdout.splitlines()[-1].split()
    return int(status), set(modules)


def session(*arguments):
    code = "import pytest\nstatus = pytest.main(sys.argv[1:])"
    return run(code, "-q", "-p", "no:cacheprovider", *OTHERS, *map(str, arguments))


def ours(modules):
    return {name for name in modules if name.partition(".")[0] == "pytest_dura"}


def test_loading_the_plugin_imports_nothing_heavy():
    _, modules = run("import pytest_dura.plugin")
    assert not modules & set(HEAVY)
    assert ours(modules) == LIGHT


def test_verify_loads_no_command_of_a_guest():
    status, modules = run(
        "from pytest_dura.__main__ import main\nstatus = main(['verify', 'none'])"
    )
    assert status == 2
    assert "pytest_dura.__main__" in modules
    commands = {"adapters.link.serve", "llm.cassette_command", "logs.command"}
    assert not modules & {f"pytest_dura.{name}" for name in commands}


def test_a_session_of_somebody_else_loads_the_entrance_alone(tmp_path):
    (tmp_path / "test_plain.py").write_text(PLAIN)
    status, modules = session(tmp_path / "test_plain.py")
    assert status == 0
    assert not modules & set(HEAVY)
    assert ours(modules) == LIGHT | GUESTS


def test_help_loads_the_entrance_alone():
    status, modules = session("--help")
    assert status == 0
    assert ours(modules) == LIGHT | GUESTS


def test_whoever_runs_episodes_does_not_load_hypothesis(project):
    """It is loaded by its own plugin, and by whoever uses strategies."""
    project.write(
        "test_driven.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/free', runs=1)\n"
        "@pytest.mark.requirement('X-1', text='it runs')\n"
        "def test_one(episode): assert not episode.collided\n",
    )
    status, modules = session("--rootdir", project.path, project.path / "test_driven.py")
    assert status == 0
    assert "pytest_dura.campaign.runner" in modules
    assert "hypothesis" not in modules


def test_a_fixture_that_is_asked_for_while_a_test_runs_begins_the_session(project):
    project.write(
        "test_late.py",
        "def test_late(request):\n"
        "    import sys\n"
        "    assert 'pytest_dura.campaign.runner' not in sys.modules\n"
        "    runner = request.getfixturevalue('orchestrator')\n"
        "    assert runner.run('corridor/free', seed=1).digest\n",
    )
    result = project.pytester.runpytest_subprocess("test_late.py")
    result.assert_outcomes(passed=1)


def test_the_package_is_loaded_from_ordinary_bytecode(tmp_path):
    """pytest's own would be made anew in each session where packages are read-only."""
    code = (
        "import pytest\n"
        "status = pytest.main(sys.argv[1:])\n"
        "from pytest_dura.plugin import options\n"
        "assert type(options.__loader__).__name__ == 'SourceFileLoader', options.__loader__"
    )
    (tmp_path / "test_plain.py").write_text(PLAIN)
    status, _ = run(code, "-q", *OTHERS, str(tmp_path / "test_plain.py"))
    assert status == 0


LOOKS = """
import gc, pytest

looks = []
gc.callbacks.append(lambda phase, info: looks.append(gc.get_freeze_count() > 0)
    if phase == "start" and info["generation"] == 2 else None)
before = gc.get_threshold()
status = pytest.main(sys.argv[1:])
print("looks", looks[-2:], gc.get_freeze_count(), gc.get_threshold() == before)
"""
DRIVEN = """
import gc
import pytest

@pytest.mark.dura(scenario="corridor/free", runs=1)
@pytest.mark.requirement("X-1", text="it runs")
def test_one(episode, request):
    assert not episode.collided
    assert gc.get_freeze_count() == 0
    assert gc.get_threshold()[0] < 100_000
"""
GARBAGE = """
class Failing:
    def __del__(self):
        raise OSError("not closed")

def test_two():
    one = Failing()
    one.other = one
"""


def _run(project, name, *command):
    """What pytest does in a process of its own with a file of the project."""
    arguments = [*OTHERS, "-q", "--rootdir", str(project.path), str(project.path / name)]
    return subprocess.run(
        [sys.executable, *command, *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("own", [True, False])
def test_pytest_looks_once_for_garbage_at_the_end_of_a_session(project, own):
    project.write("test_looks.py", DRIVEN if own else "def test_one(): pass")
    done = _run(project, "test_looks.py", "-c", f"import sys\n{LOOKS}")
    assert "1 passed" in done.stdout, done.stdout
    assert done.stdout.splitlines()[-1] == f"looks [False, {own}] 0 True"


def test_garbage_of_tests_is_still_reported(project):
    project.write("test_garbage.py", DRIVEN + GARBAGE)
    done = _run(project, "test_garbage.py", "-W", "error", "-m", "pytest", "-W", "error")
    assert "not closed" in done.stdout + done.stderr
    assert done.returncode == 1
