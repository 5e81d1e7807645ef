"""A package of somebody else that registers one of each thing, installed from its own folder."""

from __future__ import annotations

import base64
import json
import os
import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from pytest_dura.__main__ import main

PACKAGE = Path(__file__).parents[1] / "third_party"
SCENARIO = """
name: shaft/up
simulator: lift
duration: 20
world: {floor: 4.0}
requirements: [TOP-1, UP-1]
campaigns: [none, {type: slip, activation: {at: 1.0}}]
"""
REQUIREMENTS = """
requirements:
  - {id: TOP-1, text: It stops in time., kind: safety, check: always (height < 6)}
  - {id: UP-1, text: It arrives., kind: performance, check: eventually (arrived > 0)}
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder like ``site-packages`` with the package alone; it is first on the import path."""
    folder = tmp_path_factory.mktemp("lift") / "site-packages"
    pip = ["-m", "pip", "install", "--no-deps", "--no-index", "--no-build-isolation", "--quiet"]
    command = [sys.executable, *pip, "--target", str(folder), str(PACKAGE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def python(installed, tmp_path_factory, forked_workers):
    """Runs modules in a project that uses the package, in copies of a process, or ``afresh``."""
    project = tmp_path_factory.mktemp("project")
    (project / "pytest.ini").write_text("[pytest]\n")
    (project / "scenarios").mkdir()
    (project / "scenarios" / "up.yaml").write_text(SCENARIO)
    (project / "scenarios" / "requirements.yaml").write_text(REQUIREMENTS)
    kept = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
    path = os.pathsep.join(filter(None, [str(installed), os.environ.get("PYTHONPATH")]))

    def run(
        *arguments: str, beside: Path | None = None, afresh: bool = False
    ) -> subprocess.CompletedProcess[str]:
        found_in = path if beside is None else f"{beside}{os.pathsep}{path}"
        return subprocess.run(
            [*([sys.executable] if afresh else forked_workers.command()), "-m", *arguments],
            cwd=project,
            env={**kept, "PYTHONPATH": found_in},
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )

    run.project = project
    return run


@pytest.fixture(scope="module")
def session(python):
    """A session whose episodes are simulated by the package's executor."""
    chosen = ["--dura-select=shaft/*", "--dura-executor=fresh", "--dura-runs=1", "-v"]
    return python("pytest", "-p", "no:cacheprovider", "--dura-scenarios", *chosen, afresh=True)


def test_what_the_package_registers_is_listed(python):
    done = python("pytest", "--dura-list", "--dura-select=shaft/*")
    assert done.returncode == 0, done.stdout + done.stderr
    for line in (
        "  slip (number): The encoder slipped: it shows ``metres`` too little.",
        "channels of the domain lift",
        (
            "  encoder: numbers; height [m], floor [m]; shaft: upwards from the lowest floor; "
            "where it is, and where it was called to"
        ),
        "signals of the domain lift",
        "  height: [m]; of the cabin's floor above the lowest one",
        "actions of the domain lift",
        "  command.speed: [m/s]; any; upwards",
        "fault targets of the domain lift",
        "  number: encoder.height",
        "measures of the domain lift",
        "  overrun: share; runs half a metre too far",
        "  fault_injector: pytest_dura.faults.injector:CampaignInjector",
        "roles of the domain lift (override the fixture of that name)",
        "  generator: lift_dura.domain:Steady",
        "  steady: lift_dura.domain:Steady",
        "  lift: lift_dura.domain:Lift (lift-dura 1.2)",
        "  fresh: lift_dura.outputs:Fresh (lift-dura 1.2)",
        "  verdicts.csv: lift_dura.outputs (lift-dura 1.2)",
        "  heights: lift_dura.outputs:Heights (lift-dura 1.2)",
        "  travel: lift_dura.outputs:Travel (lift-dura 1.2)",
    ):
        assert line in done.stdout.splitlines(), done.stdout


def test_a_session_uses_domain_simulator_role_fault_and_executor(python, session):
    record = json.loads((python.project / "dura-evidence" / "evidence.json").read_text())
    assert "dura: episodes are simulated in a fresh process each" in session.stdout
    assert record["execution"] == {"executor": "fresh", "processes": None}
    verdicts = {(v["case"], v["requirement"]): v["verdict"] for v in record["verdicts"]}
    assert verdicts["shaft/up", "TOP-1"] == "supported", session.stdout
    assert verdicts["shaft/up+slip", "TOP-1"] == "violated", session.stdout
    assert {episode["component"] for episode in record["episodes"]} == {"Steady"}


def test_the_report_of_the_package_is_in_the_bundle_and_verified(python, session):
    bundle = python.project / "dura-evidence"
    assert "verdicts.csv" in json.loads((bundle / "manifest.json").read_text())["files"]
    report = (bundle / "verdicts.csv").read_text()
    assert "shaft/up+slip,TOP-1,violated\n" in report
    assert python("pytest_dura", "verify", str(bundle)).returncode == 0
    (bundle / "verdicts.csv").write_text(report.replace("violated", "supported"))
    done = python("pytest_dura", "verify", str(bundle))
    assert done.returncode != 0
    assert "verdicts.csv: not as it is rendered from the record" in done.stdout + done.stderr
    (bundle / "verdicts.csv").write_text(report)


def test_measures_of_the_package_are_shown_everywhere_and_verified(python, session):
    bundle = python.project / "dura-evidence"
    record = json.loads((bundle / "evidence.json").read_text())
    assert [one["name"] for one in record["measures"]] == ["arrival_time", "overrun"]
    slipped = next(case for case in record["cases"] if case["faults"])
    assert slipped["metrics"]["measures"]["overrun"]["valid"] == 1
    spread = slipped["metrics"]["measures"]["arrival_time"]
    assert spread == {"runs": 1, "mean": pytest.approx(4.0), "sd": None}
    table = [line.split() for line in session.stdout.splitlines()]
    head = next(cells for cells in table if cells[:2] == ["case", "n"])
    assert head[4:7] == ["arrival", "s", "over"]
    row = next(cells for cells in table if cells[:1] == ["shaft/up+slip"] and len(cells) > 6)
    assert row[3:6] == ["4.0", "(1)", "100"]
    assert "over: runs half a metre too far" in session.stdout
    assert "| arrival time | overrun |" in (bundle / "summary.md").read_text()
    page = (bundle / "report.html").read_text()
    assert "Arrival time by scenario" in page
    assert '<span class="chip">overrun</span>' in page
    assert "coll" not in " ".join(head)
    (episode,) = [one for one in record["episodes"] if one["case"].endswith("slip")]
    assert episode["outcome"]["measures"] == {"arrival_time": pytest.approx(4.0), "overrun": True}


def test_a_table_of_the_package_is_shown_everywhere_and_verified(python, session, capsys):
    bundle = python.project / "dura-evidence"
    file = bundle / "evidence.json"
    whole = file.read_text()
    record = json.loads(whole)
    (row, *_) = record["conclusions"]["heights"]["rows"]
    assert row[:2] == ["shaft/up", 1]
    lines = [line.split() for line in session.stdout.splitlines()]
    assert ["case", "episodes", "time", "s"] in lines
    assert ["Heights"] in lines
    assert "## Heights" in (bundle / "summary.md").read_text()
    assert "Heights</span>" in (bundle / "report.html").read_text()
    row[1] = 2
    file.write_text(json.dumps(record))
    done = python("pytest_dura", "verify", str(bundle))
    assert "/conclusions/heights/rows/0/1: found 2, expected 1" in done.stdout
    file.write_text(whole)
    # Where the package is not installed, what it concluded cannot be concluded again.
    assert main(["verify", str(bundle)]) == 1
    assert "the table 'heights' cannot be concluded again" in capsys.readouterr().out


def test_what_the_package_counts_is_a_table_with_a_line_in_the_terminal(python, session):
    bundle = python.project / "dura-evidence"
    record = json.loads((bundle / "evidence.json").read_text())
    (fact,) = [fact for fact in record["facts"] if fact["table"] == "rides"]
    assert (fact["process"], fact["data"]["made"]) == ("main", 4)  # as items used them
    assert record["conclusions"]["rides"]["rows"] == [["main", 4]]
    assert "rides: 4" in session.stdout.splitlines()
    assert "## Rides" in (bundle / "summary.md").read_text()


def test_counts_of_processes_of_merged_sessions_are_added_up(python):
    for part in ("1", "2"):
        chosen = ["--dura-select=shaft/*", "--dura-runs=1", f"--dura-shard={part}/2"]
        kept = f"--dura-evidence=part-{part}"
        given = ["-p", "no:cacheprovider", "--dura-scenarios", kept, *chosen]
        python("pytest", *given, afresh=True)
    merged = python("pytest_dura", "merge", "--output", "whole", "part-1", "part-2")
    record = json.loads((python.project / "whole" / "evidence.json").read_text())
    made = {fact["process"]: fact["data"]["made"] for fact in record["facts"]}
    assert len(made) == 2, merged.stdout + merged.stderr
    assert record["conclusions"]["rides"]["lines"] == [f"rides: {sum(made.values())}"]
    assert sum(made.values()) == 4
    again = python("pytest_dura", "merge", "--output", "again", "whole")
    assert again.returncode == merged.returncode, again.stderr
    assert (
        json.loads((python.project / "again" / "evidence.json").read_text())["facts"]
        == (record["facts"])
    )


def test_a_plot_of_the_package_is_shown_everywhere_and_verified(python, session, capsys):
    bundle = python.project / "dura-evidence"
    lines = session.stdout.splitlines()
    start = lines.index("Time of travel")
    assert lines[start + 1].startswith("shaft/up: at most ")
    assert "**Time of travel**" in (bundle / "summary.md").read_text()
    page = (bundle / "report.html").read_text()
    plots = page.partition('<section id="plots"')[2].partition("</section>")[0]
    assert '<title id="travel-title">Time of travel by case</title>' in plots
    assert "<b>All &lt;runs&gt;</b>" in plots
    assert plots.index("Arrival time by scenario") < plots.index("Time of travel")
    assert python("pytest_dura", "verify", str(bundle)).returncode == 0
    # Where the package is not installed, its pictures cannot be drawn again.
    assert main(["verify", str(bundle)]) == 1
    assert "report.html: not as it is rendered from the record" in capsys.readouterr().out


def test_a_panel_of_the_package_is_in_the_player_of_its_episodes(python, session):
    page = (python.project / "dura-evidence" / "report.html").read_text()
    packed = re.findall(r'<script type="application/octet-stream"[^>]*>([^<]+)</script>', page)
    players = [json.loads(zlib.decompress(base64.b64decode(text))) for text in packed]
    (slipped,) = [one for one in players if one["about"]["case"] == "shaft/up+slip"]
    metres = slipped["panels"]["left"]["metres"]
    assert (metres[0], max(metres)) == (4.0, pytest.approx(6.0, abs=0.2))
    # A script that no episode of the page needs is not there.
    assert re.findall(r"addPanel\(.*\)", page) == ['addPanel("left", WayLeft)']


def test_options_and_lines_of_a_guest_are_shown_under_its_name(python):
    shown = python("pytest", "--help", afresh=True).stdout
    options = shown.partition("lift: a lift as the plant:")[2].partition("\n\n")[0]
    assert "--lift-rides=N" in options
    assert "lift_rides" in shown
    listed = python("pytest", "--dura-list", "--dura-select=shaft/*", "--dura-runs=2", afresh=True)
    # Two runs of the case, two of the case with its fault, and two twins of these.
    assert "lift: 6 rides" in listed.stdout.splitlines(), listed.stdout + listed.stderr


def test_an_option_and_a_marker_of_a_guest_bring_cases(python):
    (python.project / "test_ride.py").write_text(
        "import pytest\n"
        "@pytest.mark.dura(floor=3, runs=1, verdict=False)\n"
        "def test_ride(dura_episode):\n"
        "    assert dura_episode.signals['height'].max() < 3.2\n"
    )
    listed = python("pytest", "--dura-list", "--lift-floor=2", afresh=True).stdout
    assert "  asked/floor-2: " in listed.splitlines(), listed
    tested = python("pytest", "-p", "no:cacheprovider", "-v", "test_ride.py", afresh=True)
    assert "test_ride[asked/floor-3#0] PASSED" in tested.stdout, tested.stdout + tested.stderr
    assert tested.returncode == 0
    wrong = (python.project / "test_ride.py").read_text().replace("floor=3", "flor=3")
    (python.project / "test_wrong.py").write_text(wrong)
    done = python("pytest", "-p", "no:cacheprovider", "test_wrong.py", afresh=True)
    assert "did you mean 'floor'?" in done.stdout, done.stdout
    # What names no scenario would run nothing, and pass.
    none = (python.project / "test_ride.py").read_text().replace("floor=3", "floor=90")
    (python.project / "test_wrong.py").write_text(none)
    done = python("pytest", "-p", "no:cacheprovider", "test_wrong.py", afresh=True)
    assert "has no scenario for {'floor': 90}" in done.stdout, done.stdout
    assert done.returncode == 1
    chosen = ["--dura-scenarios", "--lift-floor=90"]
    done = python("pytest", "-p", "no:cacheprovider", *chosen, afresh=True)
    assert "--lift-floor names no scenario" in done.stdout + done.stderr, done.stderr
    assert done.returncode == 4


def test_an_item_of_a_guest_is_run_recorded_and_objected_to(python):
    chosen = ["-p", "no:cacheprovider", "--dura-scenarios", "--dura-select=shaft/up"]
    given = [*chosen, "--dura-runs=1", "--lift-inspect", "-v", "--dura-evidence=inspected"]
    done = python("pytest", *given, afresh=True)
    assert "lift::inspection PASSED" in done.stdout, done.stdout + done.stderr
    record = json.loads((python.project / "inspected" / "evidence.json").read_text())
    made = {fact["about"]: fact["data"]["made"] for fact in record["facts"]}
    assert made["inspection"] == 1
    left = python("pytest", *given, "-k", "not inspection", afresh=True)
    assert "lift: no ride was made: the session left it out" in left.stdout, left.stdout
    assert left.returncode != 0


def test_a_guest_ends_a_session(python):
    chosen = ["--dura-scenarios", "--dura-select=shaft/up", "--dura-runs=1", "--lift-rides=1"]
    elsewhere = ["--dura-evidence=limited", "-p", "no:cacheprovider"]
    done = python("pytest", *chosen, *elsewhere, afresh=True)
    assert "dura: at most 1 rides" in done.stdout.splitlines(), done.stdout + done.stderr
    assert "the limit of 1 rides is reached (--lift-rides)" in done.stdout
    record = json.loads((python.project / "limited" / "evidence.json").read_text())
    assert record["status"] == "interrupted"
    assert done.returncode != 0


@pytest.mark.parametrize("value", ["crane_dura:NONE", "crane_dura:CRANE"])
def test_a_guest_that_cannot_be_used_is_one_error(python, tmp_path, value):
    other = other_package(tmp_path / "other", "CRANE = 1")
    points = f"[pytest_dura.guests]\ncrane = {value}\n"
    (other / "crane_dura-2.0.dist-info" / "entry_points.txt").write_text(points)
    done = python("pytest", "--version", "--version", beside=other, afresh=True)
    assert done.returncode == 4, done.stdout + done.stderr
    assert "the guest 'crane'" in done.stderr
    assert "correct or uninstall the package that registers it" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_catalogue_of_a_domain_has_the_package_s_faults(python):
    done = python("pytest", "--dura-list", "--dura-select=shaft/*", "--dura-faults=catalogue")
    assert "  shaft/up+slip::TOP-1" in done.stdout.splitlines(), done.stdout
    assert "  shaft/up+bias::TOP-1" in done.stdout.splitlines()
    assert "  shaft/up+object-miss::TOP-1" not in done.stdout.splitlines()


def test_the_page_of_the_package_s_domain_is_printed(python):
    done = python("pytest_dura.library.domain_reference", "lift")
    assert done.returncode == 0, done.stderr
    assert "### Signals of lift" in done.stdout
    assert "| `height` | [m] | of the cabin's floor above the lowest one |" in done.stdout
    unknown = python("pytest_dura.library.domain_reference", "lfit")
    assert unknown.returncode != 0
    assert "unknown domain 'lfit'" in unknown.stderr


def test_the_schema_for_editors_has_the_package_s_world_and_fault(python):
    done = python("pytest_dura.library.scenario", "editor.schema.json", afresh=True)
    assert done.returncode == 0, done.stderr
    schema = json.loads((python.project / "editor.schema.json").read_text())
    assert "floor" in schema["$defs"]["Shaft"]["properties"]
    assert "slip" in schema["$defs"]["FaultEntry"]["properties"]["type"]["enum"]


def other_package(folder: Path, code: str, domain: str = "crane") -> Path:
    """A second package, as pip would install it, whose module registers a domain."""
    about = folder / "crane_dura-2.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: crane-dura\nVersion: 2.0\n")
    point = f"[pytest_dura.domains]\n{domain} = crane_dura:CRANE\n"
    (about / "entry_points.txt").write_text(point)
    (folder / "crane_dura.py").write_text(f"from pytest_dura import Domain, Signal\n{code}\n")
    return folder


def test_two_domains_of_one_name_are_an_error_that_names_both(python, tmp_path):
    other = other_package(tmp_path / "other", "CRANE = Domain('lift')", domain="lift")
    done = python("pytest", "--dura-scenarios", "--dura-select=shaft/*", beside=other)
    assert done.returncode == 4, done.stdout
    text = done.stdout + done.stderr
    assert "two packages register the domain 'lift'" in text
    assert "lift-dura 1.2 (lift_dura.domain:LIFT)" in text
    assert "crane-dura 2.0 (crane_dura:CRANE)" in text
    assert "Traceback" not in text


@pytest.mark.parametrize("declared", ["'load'", "Signal('load')", "Signal('load', meaning='it')"])
def test_a_signal_without_a_unit_is_refused_where_its_domain_is_used(python, tmp_path, declared):
    code = f"CRANE = Domain('crane', signals=({declared},))"
    other = other_package(tmp_path / "other", code)
    listed = python("pytest", "--dura-list", "--dura-select=shaft/*", beside=other)
    assert listed.returncode == 0, listed.stderr  # another package's, which is not used here
    assert "the domain 'crane' of crane-dura 2.0 cannot be loaded" in listed.stdout
    assert "signal 'load'" in listed.stdout
    (python.project / "of_crane.ini").write_text("[pytest]\ndura_domain = crane\n")
    used = python("pytest", "-c", "of_crane.ini", "--dura-list", beside=other)
    assert used.returncode == 4, used.stdout
    assert "has no unit" in used.stderr
    assert "Traceback" not in used.stderr
