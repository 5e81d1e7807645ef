from __future__ import annotations

import subprocess
import sys

HEAVY = [
    "numpy", "highway_env", "rtamt", "pydantic", "yaml", "scipy", "gymnasium", "hypothesis",
    "jinja2", "jsonschema", "mcap", "sqlite3",
]  # fmt: skip


def loaded(code):
    script = f"import sys\n{code}\nprint(' '.join(m for m in {HEAVY!r} if m in sys.modules))"
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return found.stdout.split()


def test_loading_the_plugin_imports_nothing_heavy():
    assert loaded("import pytest_dura.plugin") == []


def test_a_session_of_somebody_else_imports_nothing_heavy(project):
    project.write(
        "test_plain.py",
        "import pytest\n"
        "@pytest.fixture\n"
        "def episode(): return 1\n"
        "@pytest.mark.parametrize('generator', [1])\n"
        "def test_one(episode, generator): pass\n",
    )
    code = (
        "import pytest\n"
        f"pytest.main([{str(project.path / 'test_plain.py')!r}, '-q', '-p', 'no:hypothesispytest', "
        "'-p', 'no:allure_pytest', '-p', 'no:xdist', '-p', 'no:terminal'])"
    )
    assert loaded(code) == []
