"""`python -m pytest_dura sign` on a real bundle, and what `verify --key` makes of it."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import shutil
import subprocess
import sys
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

PROJECT = Path(__file__).with_name("project")
REVIEW = """
who: Ada <b>Example</b>, independent assessor
when: "2026-11-20"
what: All verdicts, and replays of the counterexamples
decision: accepted
"""
FORMATS = (
    "report.html", "summary.md", "assurance-case.gsn.yaml", "assurance-case.svg",
    "cyclonedx.json", "test-result.intoto.json",
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The bundle of a small session."""
    folder = tmp_path_factory.mktemp("signed")
    shutil.copytree(PROJECT, folder, dirs_exist_ok=True)
    session = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--dura-scenarios",
         "--dura-select=corridor/free", "--dura-runs=1"],
        cwd=folder, env={**os.environ, "PYTEST_ADDOPTS": ""}, capture_output=True, text=True,
        timeout=60, check=False,
    )  # fmt: skip
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
        (('"2026-11-20"', "yesterday"), "review.yaml:3"),
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


def test_a_new_session_takes_the_old_signature_away(bundle, keys):
    project = bundle.parent / "project"
    shutil.copytree(PROJECT, project)
    sign(bundle, keys[0])
    shutil.move(bundle, project / "dura-evidence")
    subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--dura-scenarios",
         "--dura-select=corridor/free", "--dura-runs=1"],
        cwd=project, env={**os.environ, "PYTEST_ADDOPTS": ""}, capture_output=True,
        timeout=60, check=False,
    )  # fmt: skip
    assert (project / "dura-evidence/manifest.json").is_file()
    assert not (project / "dura-evidence/test-result.intoto.dsse.json").exists()
