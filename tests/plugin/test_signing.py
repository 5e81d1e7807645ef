"""`python -m pytest_dura sign` on a real bundle, and what `verify --key` makes of it."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import shutil
import subprocess
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_public_key,
)
from sealing import alter, seal

from pytest_dura.__main__ import main
from pytest_dura.evidence.files import file_entry, manifest_text

PROJECT = Path(__file__).with_name("project")
TODAY = datetime.now(timezone.utc).date()
REVIEW = f"""
who: Ada <b>Example</b>, independent assessor
when: "{TODAY}"
what: All verdicts, and replays of the counterexamples
decision: accepted
"""
FORMATS = (
    "report.html", "summary.md", "assurance-case.gsn.yaml", "assurance-case.svg",
    "cyclonedx.json", "test-result.intoto.json",
)  # fmt: skip


@pytest.fixture(scope="module")
def run_session(forked_workers):
    """A small session in a folder."""
    environment = {**os.environ, "PYTEST_ADDOPTS": ""}

    def run(folder, *arguments):
        shutil.copytree(PROJECT, folder, dirs_exist_ok=True)
        command = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--dura-scenarios"]
        return subprocess.run(
            forked_workers.command(*command, "--dura-runs=1", *arguments),
            cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip

    return run


@pytest.fixture(scope="module")
def made(tmp_path_factory, run_session):
    """The bundle of a small session."""
    folder = tmp_path_factory.mktemp("signed")
    session = run_session(folder, "--dura-select=corridor/free")
    bundle = folder / "dura-evidence"
    assert (bundle / "manifest.json").is_file(), session.stdout + session.stderr
    return bundle


@pytest.fixture
def bundle(made, tmp_path):
    return shutil.copytree(made, tmp_path / "bundle")


def key_pair(folder, name="key", private=None, password=None):
    """Write a pair of keys, and return their files."""
    private = private or Ed25519PrivateKey.generate()
    encryption = BestAvailableEncryption(password) if password else NoEncryption()
    secret, public = folder / f"{name}.pem", folder / f"{name}.pub"
    secret.write_bytes(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption))
    public.write_bytes(
        private.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    )
    return secret, public


@pytest.fixture
def keys(tmp_path):
    return key_pair(tmp_path)


def sign(bundle, secret, *more):
    return main(["sign", str(bundle), f"--key={secret}", *map(str, more)])


def verify(bundle, *publics):
    return main(["verify", str(bundle), *(f"--key={public}" for public in publics)])


@pytest.fixture
def review(tmp_path):
    file = tmp_path / "review.yaml"
    file.write_text(REVIEW)
    return file


def test_a_signed_bundle_is_intact_and_shows_its_key(bundle, keys, capsys):
    secret, public = keys
    assert sign(bundle, secret) == 0
    assert "signed: " in capsys.readouterr().out
    assert verify(bundle) == 0
    assert "(not checked: name the public key with --key)" in capsys.readouterr().out
    assert verify(bundle, public) == 0
    assert "test-result.intoto.json, signed by" in (text := capsys.readouterr().out)
    assert "(checked)" in text


def test_another_implementation_verifies_the_signature(bundle, keys):
    """By the words of the DSSE specification, with nothing of what signed it."""
    secret, public = keys
    sign(bundle, secret)
    envelope = json.loads((bundle / "test-result.intoto.dsse.json").read_text())
    payload = base64.b64decode(envelope["payload"])
    kind = envelope["payloadType"].encode()
    encoded = b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(payload), payload)
    key = load_pem_public_key(public.read_bytes())
    key.verify(base64.b64decode(envelope["signatures"][0]["sig"]), encoded)
    with pytest.raises(InvalidSignature):
        key.verify(base64.b64decode(envelope["signatures"][0]["sig"]), encoded + b" ")
    digest = hashlib.sha256((bundle / "evidence.json").read_bytes()).hexdigest()
    assert {"name": "evidence.json", "digest": {"sha256": digest}} in json.loads(payload)["subject"]


@pytest.mark.parametrize("kind", ["ec", "encrypted"])
def test_other_keys_sign_too(bundle, tmp_path, monkeypatch, kind):
    private = generate_private_key(SECP256R1()) if kind == "ec" else None
    password = b"open sesame" if kind == "encrypted" else None
    secret, public = key_pair(tmp_path, private=private, password=password)
    monkeypatch.setenv("DURA_SIGNING_PASSWORD", "open sesame")
    assert sign(bundle, secret) == 0
    assert verify(bundle, public) == 0


def test_what_another_key_signed_is_not_intact(bundle, keys, tmp_path, capsys):
    sign(bundle, keys[0])
    _, other = key_pair(tmp_path, "other")
    assert verify(bundle, other) == 1
    assert "test-result.intoto.dsse.json: not signed by the key of --key" in capsys.readouterr().out
    assert verify(bundle, other, keys[1]) == 0


def test_an_unsigned_bundle_is_not_what_a_key_asks_for(bundle, keys, capsys):
    assert verify(bundle, keys[1]) == 1
    assert "missing; this bundle is not signed" in capsys.readouterr().out


def test_a_forged_bundle_does_not_keep_its_signature(bundle, keys, capsys):
    """One whose record, statement and manifest agree with each other once more."""
    sign(bundle, keys[0])
    alter(bundle, lambda record: record.update(base_seed=7))
    statement = bundle / "test-result.intoto.json"
    data = json.loads(statement.read_text())
    digest = hashlib.sha256((bundle / "evidence.json").read_bytes()).hexdigest()
    data["subject"][-1]["digest"]["sha256"] = digest
    statement.write_text(json.dumps(data, indent=1) + "\n")
    (bundle / "test-result.intoto.dsse.json").rename(kept := bundle.parent / "kept")
    seal(bundle)
    kept.rename(bundle / "test-result.intoto.dsse.json")
    assert verify(bundle, keys[1]) == 1
    out = capsys.readouterr().out
    assert "test-result.intoto.dsse.json: of another test-result.intoto.json" in out


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data["signatures"].clear(),
        lambda data: data["signatures"][0].update(sig="AAAA"),
        lambda data: data["signatures"][0].pop("keyid"),
        lambda data: data.update(payloadType="text/plain"),
        lambda data: data.update(payload="!"),
        lambda data: data.pop("payload"),
    ],
)
def test_a_damaged_envelope_is_a_difference(bundle, keys, capsys, damage):
    sign(bundle, keys[0])
    file = bundle / "test-result.intoto.dsse.json"
    data = json.loads(file.read_text())
    damage(data)
    file.write_text(json.dumps(data))
    assert verify(bundle, keys[1]) == 1
    assert capsys.readouterr().out.count("test-result.intoto.dsse.json: ") == 1


def test_a_second_signer_adds_a_signature(bundle, keys, tmp_path):
    sign(bundle, keys[0])
    secret, public = key_pair(tmp_path, "second")
    sign(bundle, secret)
    assert verify(bundle, keys[1]) == verify(bundle, public) == 0


def test_a_signed_review_changes_what_each_report_says(bundle, keys, review, capsys):
    assert (
        main(["export", "cyclonedx", str(bundle)]) == main(["export", "in-toto", str(bundle)]) == 0
    )
    unreviewed = {name: (bundle / name).read_text() for name in FORMATS}
    record = (bundle / "evidence.json").read_bytes()
    assert all("unreviewed" in text for text in unreviewed.values())
    assert sign(bundle, keys[0], "--review", review) == 0
    assert "reviewed: accepted by Ada" in capsys.readouterr().out
    for name in FORMATS:
        text = (bundle / name).read_text()
        assert "unreviewed" not in text, name
        assert "accepted" in text, name
        assert name.endswith((".yaml", ".json", ".md")) or "<b>Example" not in text, name
    assert (bundle / "evidence.json").read_bytes() == record
    assert verify(bundle, keys[1]) == 0
    assert "accepted by Ada" in capsys.readouterr().out


def test_a_review_of_another_record_counts_for_nothing(bundle, made, keys, review, capsys):
    other = shutil.copytree(made, bundle.parent / "other")
    alter(other, lambda record: record.update(base_seed=7))
    sign(bundle, keys[0], "--review", review)
    capsys.readouterr()
    shutil.copy(bundle / "review.dsse.json", other)
    assert verify(other) == 1
    assert "review.dsse.json: a review of another evidence.json" in capsys.readouterr().out


def test_reports_without_their_review_are_not_intact(bundle, keys, review, capsys):
    sign(bundle, keys[0], "--review", review)
    (bundle / "review.dsse.json").unlink()
    assert verify(bundle, keys[1]) == 1
    assert "report.html: not as it is rendered from the record" in capsys.readouterr().out


def test_a_bundle_that_is_not_intact_is_not_signed(bundle, keys, capsys):
    (bundle / "summary.md").write_text("all is well\n")
    assert sign(bundle, keys[0]) == 2
    assert "not intact" in capsys.readouterr().err
    assert not (bundle / "test-result.intoto.dsse.json").exists()


@pytest.mark.parametrize(
    "change, problem",
    [
        ((f'"{TODAY}"', "yesterday"), "review.yaml:3"),
        ((str(TODAY), str(TODAY - timedelta(days=2))), "dated before the session ended"),
        (("accepted", "perhaps"), "review.yaml:5"),
        (("decision: accepted", ""), "the key 'decision' is missing"),
    ],
)
def test_a_review_that_says_too_little_is_refused(bundle, keys, capsys, change, problem):
    review = bundle.parent / "review.yaml"
    review.write_text(REVIEW.replace(*change))
    assert sign(bundle, keys[0], "--review", review) == 2
    assert problem in capsys.readouterr().err
    assert not (bundle / "review.dsse.json").exists()


@pytest.mark.parametrize("content", [b"", b"no key", None])
def test_a_key_that_cannot_be_used_is_refused(bundle, tmp_path, capsys, content):
    file = tmp_path / "bad.pem"
    if content is not None:
        file.write_bytes(content)
    assert sign(bundle, file) == 2
    assert "bad.pem: " in capsys.readouterr().err
    sign(bundle, key_pair(tmp_path)[0])
    assert verify(bundle, file) == 2


def test_a_new_session_takes_the_old_signature_away(bundle, keys, run_session):
    project = bundle.parent / "project"
    project.mkdir()
    sign(bundle, keys[0])
    shutil.move(bundle, project / "dura-evidence")
    run_session(project, "--dura-select=corridor/free")
    assert (project / "dura-evidence/manifest.json").is_file()
    assert not (project / "dura-evidence/test-result.intoto.dsse.json").exists()


def with_report(bundle):
    """Change a report, and list it anew."""
    file = bundle / "summary.md"
    file.write_text(file.read_text().replace("failed", "passed"))
    list_again(bundle)


def list_again(bundle, *more):
    """Write a manifest that agrees with the files that it lists, and lists more of them."""
    listed = json.loads((bundle / "manifest.json").read_text())["files"]
    names = [name for name in (*listed, *more) if (bundle / name).is_file()]
    files = {name: file_entry(bundle / name) for name in names}
    (bundle / "manifest.json").write_text(manifest_text(files))


def with_file(name, *, listed=False):
    """Add a file to a bundle."""

    def change(bundle):
        (bundle / name).parent.mkdir(parents=True, exist_ok=True)
        (bundle / name).write_text("{}")
        if listed:
            list_again(bundle, name)

    return change


def without_file(name, *, listed=False):
    """Remove a file from a bundle."""

    def change(bundle):
        (bundle / name).unlink()
        if not listed:
            list_again(bundle)

    return change


RESUMED = f".episodes/ab/{'a' * 64}.episode"
CHANGES = {
    "a report": with_report,
    "a file added": with_file("notes.txt"),
    "a file added and listed": with_file("notes.txt", listed=True),
    "a file added in a folder": with_file("episodes/more/notes.txt"),
    "an episode to resume from": with_file(RESUMED),
    "a report removed": without_file("report.html"),
    "a file removed that is listed": without_file("summary.md", listed=True),
    "a review added": with_file("review.dsse.json"),
    "a manifest in another form": lambda bundle: (bundle / "manifest.json").write_text(
        (bundle / "manifest.json").read_text() + " "
    ),
}


@pytest.fixture(scope="module")
def failed(tmp_path_factory, run_session):
    """The bundle of a session whose gate failed."""
    folder = tmp_path_factory.mktemp("failed")
    run_session(folder, "--dura-select=corridor/tight", "--dura-generator=corridor:Reckless")
    return folder / "dura-evidence"


@pytest.fixture
def failing(failed, tmp_path):
    return shutil.copytree(failed, tmp_path / "failing")


@pytest.mark.parametrize("case", CHANGES)
@pytest.mark.parametrize("version", ["this", "another"])
def test_a_signature_covers_every_file(failing, keys, monkeypatch, case, version):
    """Also where another version wrote the reports, which are not rendered again."""
    assert sign(failing, keys[0]) == 0
    assert verify(failing, keys[1]) == 0
    if version == "another":
        monkeypatch.setattr("pytest_dura.evidence.verify._other_version", lambda record: "0.0.1")
        assert verify(failing, keys[1]) == 3
    CHANGES[case](failing)
    assert verify(failing, keys[1]) == 1


def test_a_bundle_with_files_that_no_signature_would_cover_is_not_signed(failing, keys, capsys):
    with_file(RESUMED)(failing)
    assert verify(failing) == 0
    assert sign(failing, keys[0]) == 2
    assert f"{RESUMED}: not in the manifest" in capsys.readouterr().err


SAME = "the review is signed with the key that signed the evidence"
ANOTHER = "the review is signed with another key than the evidence"
UNSIGNED = "the evidence was not signed before the review"


@pytest.mark.parametrize(
    "signers",
    [("maker", "maker", SAME), ("maker", "assessor", ANOTHER), (None, "assessor", UNSIGNED)],
)
def test_every_format_says_whose_key_signed_a_review(bundle, tmp_path, review, capsys, signers):
    producer, reviewer, remark = signers
    main(["export", "cyclonedx", str(bundle)])
    pairs = {name: key_pair(tmp_path, name) for name in ("maker", "assessor", "stranger")}
    if producer is not None:
        sign(bundle, pairs[producer][0])
    sign(bundle, pairs[reviewer][0], "--review", review)
    assert remark in capsys.readouterr().out
    for name in FORMATS:
        assert remark in " ".join((bundle / name).read_text().split()), name
    assert verify(bundle, *(pair[1] for pair in pairs.values())) == 0
    assert remark in (out := capsys.readouterr().out)
    assert "not checked" not in out
    # With the reviewer's key alone, another one of the evidence is only what the envelope says.
    assert verify(bundle, pairs[reviewer][1]) == 0
    out = capsys.readouterr().out
    assert remark in out
    assert ("(not checked: name its public key" in out) == (remark == ANOTHER)
    # Whoever reviews it again has signed it, and has not made it.
    sign(bundle, pairs["stranger"][0], "--review", review)
    assert (UNSIGNED if producer is None else ANOTHER) in capsys.readouterr().out


def test_an_accepted_review_of_a_failed_gate_says_what_was_accepted(failing, keys, review, capsys):
    words = (
        "All verdicts, and replays of the counterexamples",
        "the gate did not pass (failed), which no review changes",
    )
    main(["export", "cyclonedx", str(failing)])
    sign(failing, keys[0], "--review", review)
    out = capsys.readouterr().out
    assert all(part in out for part in words)
    for name in FORMATS:
        text = " ".join((failing / name).read_text().split())
        assert all(part in text for part in words), name
    verify(failing, keys[1])
    line = next(each for each in capsys.readouterr().out.splitlines() if "accepted" in each)
    assert all(part in line for part in words)


def test_a_review_from_before_the_session_counts_for_nothing(
    bundle, keys, review, capsys, monkeypatch
):
    """Also if another tool than ours has signed it."""
    review.write_text(REVIEW.replace(str(TODAY), str(TODAY - timedelta(days=2))))
    with monkeypatch.context() as lenient:
        lenient.setattr("pytest_dura.evidence.signing.is_too_early", lambda review, ended: False)
        assert sign(bundle, keys[0], "--review", review) == 0
    capsys.readouterr()
    assert verify(bundle, keys[1]) == 1
    out = capsys.readouterr().out
    assert "review.dsse.json: dated " in out
    assert "before the session ended" in out
    assert "report.html: not as it is rendered from the record" in out


def test_a_review_holds_no_signature_of_other_evidence(bundle, failing, keys, review, capsys):
    sign(failing, keys[0])
    shutil.copy(failing / "test-result.intoto.dsse.json", bundle)
    capsys.readouterr()
    assert sign(bundle, keys[0], "--review", review) == 2
    assert "it is of another evidence.json" in capsys.readouterr().err
