"""What a real session's record says of where it comes from."""

from __future__ import annotations

import hashlib
import site
import sys

import pytest

from pytest_dura.evidence import check_record

OWN_TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/free", runs=1)
@pytest.mark.requirement("OWN-1")
def test_it(episode):
    pass
"""
OWN_REQUIREMENT = """
requirements:
  - {id: OWN-1, text: "Of its own.", kind: safety, check: "own_checks:fine"}
"""


def sha256(file):
    return hashlib.sha256(file.read_bytes()).hexdigest()


def inputs(project):
    return {(one.kind, one.path): one for one in project.evidence().inputs}


@pytest.fixture
def full_project(project):
    """One with an input of each kind that a session can have."""
    project.write("own_checks.py", "def fine(episode):\n    return True\n")
    project.write("scenarios/requirements-own.yaml", OWN_REQUIREMENT)
    project.write("faults.yaml", "campaigns: [none]\n")
    for role, name in (("Careful", "planned"), ("Watch", "watched")):
        project.write(
            f"{name}.py",
            f"import corridor\nimport {name}_aid\nclass My{role}(corridor.{role}):\n    pass\n",
        )
        project.write(f"{name}_aid.py", f"from {name}_deep import depth\n")
        project.write(f"{name}_deep.py", "depth = 1\n")
    tight = project.path / "scenarios/corridor/tight.yaml"
    roles = '{generator: "planned:MyCareful", safety_monitor: "watched:MyWatch"}'
    tight.write_text(tight.read_text().replace('{generator: "corridor:Careful"}', roles))
    project.write("tests/conftest.py", "")
    project.write("conftest.py", "")
    project.write("tests/test_own.py", OWN_TEST)
    project.write("tests/test_other.py", "def test_nothing():\n    pass\n")
    return project


def test_every_input_file_is_listed_with_its_digest(full_project):
    project = full_project
    # With a worker, since the controller then collects nothing itself.
    project.scenarios("tests", "--dura-faults=faults.yaml", "-n", "1", select="corridor/tight")
    found = inputs(project)
    assert set(found) >= {
        ("scenario", "scenarios/corridor/tight.yaml"),
        ("scenario", "scenarios/corridor/free.yaml"),
        ("requirements", "scenarios/requirements.yaml"),
        ("requirements", "scenarios/requirements-own.yaml"),
        ("check", "own_checks.py"),
        ("faults", "faults.yaml"),
        ("test", "tests/test_own.py"),
        ("conftest", "tests/conftest.py"),
        ("conftest", "conftest.py"),
        ("configuration", "pytest.ini"),
        ("role", "corridor.py"),
        ("role", "watched.py"),
        ("role", "watched_aid.py"),
        ("role", "watched_deep.py"),
        ("component", "corridor.py"),
        ("component", "planned.py"),
        ("component", "planned_aid.py"),
        ("component", "planned_deep.py"),
    }
    assert ("test", "tests/test_other.py") not in found
    for (_, path), one in found.items():
        if (project.path / path).exists():
            assert one.sha256 == sha256(project.path / path)
        assert not one.changed
        assert str(project.path) not in path
        assert not path.startswith(("/", ".."))


BULK = {
    "bulk/__init__.py": "import bulk_base\n",
    "bulk_base.py": "x = 1\n",
    "bulk-4.5.6.dist-info/METADATA": "Metadata-Version: 2.1\nName: bulk\nVersion: 4.5.6\n",
    "bulk-4.5.6.dist-info/RECORD": "bulk/__init__.py,,\nbulk/part.py,,\nbulk_base.py,,\n",
}


@pytest.mark.parametrize("below_root", [False, True])
@pytest.mark.parametrize("folder", ["lib/site-packages", "ros/dist-packages", "deps"])
def test_a_distribution_is_installed_wherever_it_lies_and_not_read(
    full_project, tmp_path_factory, monkeypatch, folder, below_root
):
    project = full_project
    outside = tmp_path_factory.mktemp("outside")
    packages = (project.path / ".venv" if below_root else outside) / folder
    for name, text in BULK.items():
        project.write(packages / name, text)
    # A session that tries to read all of it lists no imports of the component.
    (packages / "bulk/part.py").symlink_to(packages / "nowhere")
    project.write(outside / "other.pth", f"{packages}\n")
    monkeypatch.setattr(sys, "path", [*sys.path])
    site.addsitedir(str(outside))
    project.write("planned_aid.py", "import bulk\nfrom planned_deep import depth\n")

    project.scenarios(select="corridor/tight")
    assert project.evidence().environment.packages["bulk"] == "4.5.6"
    found = inputs(project)
    assert ("component", "planned_deep.py") in found
    assert not [path for _, path in found if "bulk" in path]


def test_a_real_record_is_valid_by_its_schema_also_with_the_baseline_that_it_replaces(project):
    project.scenarios()
    before = sha256(project.path / "dura-evidence/evidence.json")
    assert check_record(project.evidence().to_json()) == []
    project.scenarios("--dura-baseline=dura-evidence")
    assert check_record(project.evidence().to_json()) == []
    told = inputs(project)["baseline", "dura-evidence/evidence.json"]
    assert (told.sha256, told.changed) == (before, False)


def test_a_file_that_changes_meanwhile_is_told(project):
    project.write(
        "conftest.py",
        "import pathlib\n"
        "def pytest_runtest_teardown(item):\n"
        "    file = pathlib.Path('scenarios/corridor/tight.yaml')\n"
        "    file.write_text(file.read_text() + '# changed\\n')\n",
    )
    before = sha256(project.path / "scenarios/corridor/tight.yaml")
    project.scenarios(select="corridor/tight")
    found = inputs(project)
    assert found["scenario", "scenarios/corridor/tight.yaml"].to_json() == {
        "kind": "scenario", "path": "scenarios/corridor/tight.yaml", "sha256": before,
        "changed": True,
    }  # fmt: skip
    assert not found["requirements", "scenarios/requirements.yaml"].changed


def test_cells_and_ranges_of_a_real_session(project):
    project.scenarios()
    coverage = project.evidence().coverage
    words = {(one.case, one.requirement): one.verdict for one in project.evidence().verdicts}
    tested = [cell for cell in coverage.cells if cell.verdict is not None]
    assert {(cell.case, cell.requirement): cell.verdict for cell in tested} == words
    variation = {
        (case.scenario, path) for case in project.evidence().cases for path in case.variation
    }
    assert {(one.scenario, one.parameter) for one in coverage.parameters} == variation
