"""Formats on request: a session's, those that `export` adds to a bundle, and another package's."""

from __future__ import annotations

import json
import shutil
import sys

import pytest
from corridors import scenario
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from stated_counts import stated_counts

from pytest_dura.__main__ import main
from pytest_dura.evidence import FORMATS, open_record, verify_bundle
from pytest_dura.evidence.files import listed_files

DEFAULT = {
    "evidence.json", "report.html", "summary.md", "assurance-case.gsn.yaml", "assurance-case.svg",
}  # fmt: skip
EXPORTS = {
    "cyclonedx": "cyclonedx.json", "in-toto": "test-result.intoto.json", "needs": "needs.json"
}  # fmt: skip
OWN = """
from pytest_dura import FORMATS

@FORMATS.register("verdicts.csv")
class Verdicts:
    EXPORT = "csv"

    @staticmethod
    def render(record):
        return "".join(f"{each.requirement},{each.verdict}\\n" for each in record.head.verdicts)
"""


def files(folder):
    return {name for name in listed_files(folder) if not name.startswith("episodes/")}


def session(project, *options):
    scenario(project, requirements="[GAP-1]")
    result = project.run("corridor/it", *options)
    return project.path / "dura-evidence", result


def test_a_bundle_has_what_people_read_and_other_formats_on_request(project):
    bundle, _ = session(project)
    assert files(bundle) == DEFAULT
    for short, name in EXPORTS.items():
        assert main(["export", short, str(bundle)]) == 0
        assert verify_bundle(bundle).problems == []
        totals = open_record(bundle / "evidence.json").head.totals.to_json()
        assert stated_counts(name, (bundle / name).read_text()) == totals
    assert files(bundle) == DEFAULT | {*EXPORTS.values()}
    for name in EXPORTS.values():
        text = (bundle / name).read_text()
        (bundle / name).write_text(text + " ")
        assert any(name in problem for problem in verify_bundle(bundle).problems)
        (bundle / name).write_text(text)
    # The next session begins anew.
    session(project)
    assert files(bundle) == DEFAULT
    assert verify_bundle(bundle).problems == []


@pytest.mark.parametrize("ini", [False, True])
def test_a_session_makes_the_formats_that_it_is_asked_for(project, ini):
    options = ["--dura-export=needs", "--dura-export=cyclonedx.json"]
    if ini:
        options = ["-o", "dura_export=needs cyclonedx"]
    bundle, result = session(project, *options)
    assert result.ret == 0
    assert files(bundle) == DEFAULT | {"needs.json", "cyclonedx.json"}
    assert verify_bundle(bundle).problems == []


def test_an_unknown_format_is_refused_before_anything_runs(project, capsys):
    bundle, result = session(project, "--dura-export=cyclondx")
    text = result.stdout.str() + result.stderr.str()
    assert result.ret == 4
    assert "there is no export format 'cyclondx'" in text
    assert "did you mean 'cyclonedx'" in text
    assert not bundle.exists()
    session(project)
    assert main(["export", "summary.md", str(bundle)]) == 2
    assert "one of " in capsys.readouterr().err


def test_an_export_elsewhere_leaves_the_bundle_as_it_is(project, capsys):
    bundle, _ = session(project)
    before = (bundle / "manifest.json").read_bytes()
    outside = project.path / "out.json"
    assert main(["export", "needs", str(bundle), f"--output={outside}"]) == 0
    assert (bundle / "manifest.json").read_bytes() == before
    assert json.loads(outside.read_text())["versions"]
    (bundle / "summary.md").write_text("all is well\n")
    capsys.readouterr()
    assert main(["export", "needs", str(bundle)]) == 2
    assert "differs from its manifest" in capsys.readouterr().err
    assert not (bundle / "needs.json").exists()


def test_signing_makes_the_statement_and_closes_the_bundle(project, capsys):
    bundle, _ = session(project)
    key, public = Ed25519PrivateKey.generate(), project.path / "key.pem"
    public.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    assert main(["sign", str(bundle), f"--key={public}"]) == 0
    assert files(bundle) == DEFAULT | {"test-result.intoto.json"}
    assert verify_bundle(bundle).problems == []
    capsys.readouterr()
    assert main(["export", "needs", str(bundle)]) == 2
    assert "--output FILE, or export before it is signed" in capsys.readouterr().err
    for command in ("sign", "verify"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert "pip install 'pytest-dura[signing]'" in capsys.readouterr().out


def test_a_merged_bundle_has_the_formats_of_its_parts(project):
    scenario(project, requirements="[GAP-1]")
    parts = []
    for number, more in ((1, ["--dura-export=needs"]), (2, [])):
        project.scenarios(f"--dura-shard={number}/2", *more)
        parts.append(shutil.move(project.path / "dura-evidence", project.path / f"part-{number}"))
    whole = project.path / "whole"
    main(["merge", *map(str, parts), f"--output={whole}"])
    assert files(whole) == DEFAULT | {"needs.json"}
    assert verify_bundle(whole).problems == []


def test_a_format_of_a_project_costs_a_class_with_a_name(project, request):
    request.addfinalizer(lambda: FORMATS._registered.pop("verdicts.csv", None))
    project.write("conftest.py", OWN)
    bundle, _ = session(project)
    assert files(bundle) == DEFAULT
    session(project, "--dura-export=csv")
    assert files(bundle) == DEFAULT | {"verdicts.csv"}
    assert (bundle / "verdicts.csv").read_text() == "GAP-1,supported\n"


def test_commands_know_what_a_module_registers_that_is_named(project, request, monkeypatch, capsys):
    def forget():
        FORMATS._registered.pop("verdicts.csv", None)
        sys.modules.pop("own_format", None)

    request.addfinalizer(forget)
    project.write("own_format.py", OWN.replace('EXPORT = "csv"', ""))
    monkeypatch.syspath_prepend(project.path)
    bundle, _ = session(project, "-p", "own_format")
    assert files(bundle) == DEFAULT | {"verdicts.csv"}
    forget()
    assert main(["verify", str(bundle)]) == 1
    assert "verdicts.csv: in the manifest, and no file of this bundle" in capsys.readouterr().out
    assert main(["-p", "own_format", "verify", str(bundle)]) == 0
    (bundle / "verdicts.csv").write_text("GAP-1,violated\n")
    assert main(["-p", "own_format", "verify", str(bundle)]) == 1
    shown = capsys.readouterr().out
    assert "verdicts.csv: not as it is rendered from the record" in shown
    assert main(["-p", "no_such_format", "verify", str(bundle)]) == 2
    assert "No module named 'no_such_format'" in capsys.readouterr().err
