"""Sign a bundle, and record a review of it: DSSE envelopes around in-toto statements.

``sign`` leaves two files beside a bundle. Both are optional, and neither is in its manifest:

- ``test-result.intoto.dsse.json`` holds the bundle's statement, whose subjects are the record, the
  manifest, which has the SHA-256 of each file, and the review, if there is one.
- ``review.dsse.json`` holds a statement on the record, too: who reviewed it, when, what, the
  decision, and the signature that the bundle had by then. Reports that are rendered with it no
  longer say "unreviewed".

To read them needs nothing; to make or check a signature needs the extra ``signing``. Envelopes are
those of DSSE 1.0 (https://github.com/secure-systems-lab/dsse), so that other tools check them.
"""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.evidence.files import (
    MANIFEST_FILE,
    REVIEW_FILE,
    SIGNATURE_FILE,
    SIGNED_FILES,
    file_entry,
    write_file,
)
from pytest_dura.evidence.text import name

if TYPE_CHECKING:
    from securesystemslib.dsse import Envelope
    from securesystemslib.signer import Key

STATEMENT_FILE = "test-result.intoto.json"
PASSWORD = "DURA_SIGNING_PASSWORD"  # noqa: S105 - name of an environment variable
"""Environment variable with the password of an encrypted private key."""
_RECORD_FILE = "evidence.json"
_PAYLOAD_TYPE = "application/vnd.in-toto+json"
_STATEMENT = "https://in-toto.io/Statement/v1"
_REVIEW = "urn:pytest-dura:review:v0.1"
_COVERING = (MANIFEST_FILE, REVIEW_FILE)
"""Files that a signed statement names beside the record."""
_EVIDENCE_KEY = "evidenceSignature"
"""Key of a review with the envelope of the bundle as it was when it was reviewed."""
_DAY_BEGINS_LAST = 12
"""Hours after UTC at which a day begins where it begins last."""
_NAME_LIMIT = 400
"""Characters of a reviewer's name, and of what was reviewed."""
_SHORT_ID = 16
"""Characters of a key's id that are shown."""
_MAX_BYTES = 16 << 20
"""Size of the largest envelope that is read."""

_Text = Annotated[str, StringConstraints(min_length=1, max_length=2000, strip_whitespace=True)]


class Review(BaseModel):
    """Review of a session's evidence by a person, as in ``review.yaml``."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    who: Annotated[_Text, Field(description="Name and role of the reviewer.")]
    when: Annotated[
        str,
        StringConstraints(pattern=r"^\d{4}-\d{2}-\d{2}$"),
        Field(description="Day, YYYY-MM-DD."),
    ]
    what: Annotated[_Text, Field(description="What was reviewed, and on which conditions.")]
    decision: Annotated[
        Literal["accepted", "rejected"], Field(description="`accepted` or `rejected`.")
    ]


@dataclass(frozen=True)
class Signed:
    """Content of an envelope, which was not checked.

    Args:
        payload: The signed bytes.
        key_ids: Ids of the keys that claim to have signed it.
        data: The envelope as plain data.
    """

    payload: bytes
    key_ids: tuple[str, ...]
    data: Mapping[str, Any]

    @classmethod
    def read(cls, file: Path) -> Signed:
        """Read an envelope.

        Raises:
            ValueError: If it is none, or not of an in-toto statement.
            OSError: If it cannot be read.
        """
        if file.is_symlink() or file.stat().st_size > _MAX_BYTES:
            raise ValueError("a link, or too large")
        try:
            return cls.of(json.loads(file.read_bytes()))
        except RecursionError as error:
            raise ValueError(f"no envelope ({describe_error(error)})") from None

    @classmethod
    def of(cls, data: Any) -> Signed:
        """Make it of an envelope's plain data.

        Raises:
            ValueError: If it is none, or not of an in-toto statement.
        """
        try:
            if data["payloadType"] != _PAYLOAD_TYPE:
                raise ValueError("not of an in-toto statement")
            key_ids = tuple(str(each["keyid"]) for each in data["signatures"])
            payload = base64.b64decode(data["payload"], validate=True)
        except (LookupError, TypeError, AttributeError) as error:
            raise ValueError(f"no envelope ({describe_error(error)})") from None
        if not key_ids:
            raise ValueError("without a signature")
        return cls(payload, key_ids, data)


@dataclass(frozen=True)
class SignedReview:
    """A review of this very record, whose signature is not checked.

    Args:
        review: What it says.
        signed: Its envelope.
        evidence: The envelope of the bundle as it was when it was reviewed; ``None`` for one that
            was not signed.
    """

    review: Review
    signed: Signed
    evidence: Signed | None

    @property
    def decision(self) -> str:
        """Who decided what on which day."""
        who, what = (name(part, _NAME_LIMIT) for part in (self.review.who, self.review.what))
        return f"{self.review.decision} by {who} on {self.review.when}: {what}"

    def remarks(self, gate: str) -> str:
        """Say what the review does not change, and whether another key signed the evidence.

        Args:
            gate: Result of the session's gate.
        """
        return "; ".join([*_gate_remark(self.review, gate), self.independence()])

    def independence(self, reviewers: Collection[str] = (), producers: Collection[str] = ()) -> str:
        """Say whether another key signed the evidence before the review.

        Args:
            reviewers: Ids of the keys whose signatures of the review were checked; by default those
                that its envelope names.
            producers: The same of the evidence.
        """
        if self.evidence is None:
            return "the evidence was not signed before the review"
        if set(reviewers or self.signed.key_ids) <= set(producers or self.evidence.key_ids):
            return "the review is signed with the key that signed the evidence"
        return "the review is signed with another key than the evidence"


def _gate_remark(review: Review, gate: str) -> list[str]:
    if gate == "passed" or review.decision != "accepted":
        return []
    return [f"the gate did not pass ({gate}), which no review changes"]


def read_review(directory: Path, ended: str) -> SignedReview | None:
    """Return the review that lies beside a bundle, if it is one of this very record.

    Its signature is not checked here; ``verify --key`` does that.

    Args:
        directory: The bundle.
        ended: When the session ended, in ISO 8601.
    """
    try:
        return _review_of(Signed.read(directory / REVIEW_FILE), directory, ended)
    except (OSError, ValueError):
        return None


def _review_of(signed: Signed, directory: Path, ended: str) -> SignedReview:
    """The review in an envelope.

    Raises:
        ValueError: If it holds none, or one of another record, or from before the session's end.
    """
    try:
        statement = json.loads(signed.payload)
        predicate_type, subjects = statement["predicateType"], statement["subject"]
        predicate = dict(statement["predicate"])
        earlier = predicate.pop(_EVIDENCE_KEY)
        review = Review.model_validate(predicate)
    except (LookupError, TypeError, RecursionError, ValidationError) as error:
        raise ValueError(f"no review ({describe_error(error)})") from None
    if predicate_type != _REVIEW:
        raise ValueError("no review")
    if subjects != [_subject(directory)]:
        raise ValueError(f"a review of another {_RECORD_FILE}")
    if is_too_early(review, ended):
        raise ValueError(f"dated {review.when}, before the session ended ({ended})")
    evidence = None if earlier is None else Signed.of(earlier)
    if evidence is not None and not _is_on_record(evidence, directory):
        raise ValueError(f"it holds the signature of another {_RECORD_FILE}")
    return SignedReview(review, signed, evidence)


def is_too_early(review: Review, ended: str) -> bool:
    """Whether a review is dated before the day on which the session ended, wherever on earth.

    Args:
        review: The review.
        ended: When the session ended, in ISO 8601.
    """
    try:
        earliest = datetime.fromisoformat(ended) - timedelta(hours=_DAY_BEGINS_LAST)
    except OverflowError:  # in the year 1
        return False
    return review.when < earliest.date().isoformat()


def _is_on_record(signed: Signed, directory: Path) -> bool:
    try:
        return _subject(directory) in json.loads(signed.payload)["subject"]
    except (ValueError, LookupError, TypeError, RecursionError):
        return False


def _subject(directory: Path, name: str = _RECORD_FILE) -> dict[str, Any]:
    digest = file_entry(directory / name)["sha256"]
    return {"name": name, "digest": {"sha256": digest}}


def write_review(directory: Path, review: Review, key: Path, ended: str) -> None:
    """Sign a review of a bundle's record, and write it beside the bundle.

    Args:
        directory: The bundle.
        review: The review.
        key: File with the reviewer's private key.
        ended: When the session ended, in ISO 8601.

    Raises:
        ConfigurationError: If the key or the extra ``signing`` cannot be used, the review is dated
            before the session ended, or the bundle has a signature that is not its own.
    """
    if is_too_early(review, ended):
        raise ConfigurationError(
            "this review is dated before the session ended",
            key="when",
            found=review.when,
            expected=f"the day of the review, not before {ended}",
            remedy="correct the date",
        )
    evidence = _signature_before_review(directory, ended)
    statement = {
        "_type": _STATEMENT,
        "subject": [_subject(directory)],
        "predicateType": _REVIEW,
        "predicate": {
            **review.model_dump(),
            _EVIDENCE_KEY: None if evidence is None else evidence.data,
        },
    }
    payload = (json.dumps(statement, indent=1, ensure_ascii=False) + "\n").encode()
    _write_signed(directory / REVIEW_FILE, payload, key)


def _signature_before_review(directory: Path, ended: str) -> Signed | None:
    """Return the signature of a bundle before any review of it.

    Raises:
        ConfigurationError: If the signature beside it is not on its record.
    """
    earlier = read_review(directory, ended)
    if earlier is not None:  # whose reviewer signed the bundle, too
        return earlier.evidence
    if not os.path.lexists(directory / SIGNATURE_FILE):
        return None
    try:
        signed = Signed.read(directory / SIGNATURE_FILE)
        problem = None if _is_on_record(signed, directory) else f"it is of another {_RECORD_FILE}"
    except (OSError, ValueError) as error:
        problem = str(error)
    if problem is not None:
        raise ConfigurationError(
            f"the signature of this bundle cannot be used: {problem}",
            file=str(directory / SIGNATURE_FILE),
            expected="the signature of the maker of the evidence, or none",
            remedy="restore the file, or remove it to review evidence that is not signed",
        )
    return signed


def sign_statement(directory: Path, key: Path) -> str:
    """Sign a bundle's statement, and return the key's id.

    An envelope that already holds this statement gets one signature more.

    Raises:
        ConfigurationError: If the key or the extra ``signing`` cannot be used.
    """
    return _write_signed(directory / SIGNATURE_FILE, _signed_statement(directory), key)


def _signed_statement(directory: Path) -> bytes:
    """Write the bundle's statement with the files that hold the digests of all others."""
    statement = json.loads((directory / STATEMENT_FILE).read_bytes())
    names = [name for name in _COVERING if os.path.lexists(directory / name)]
    statement["subject"] += [_subject(directory, name) for name in names]
    return (json.dumps(statement, indent=1) + "\n").encode()


def _write_signed(file: Path, payload: bytes, key: Path) -> str:
    securesystemslib = _library()
    envelope = securesystemslib.Envelope(payload, _PAYLOAD_TYPE, {})
    try:
        earlier = Signed.read(file)
    except (OSError, ValueError):
        earlier = None
    if earlier is not None and earlier.payload == payload:
        envelope = _envelope(earlier)
    signature = envelope.sign(_signer(key))
    write_file(file, [json.dumps(envelope.to_dict(), indent=1) + "\n"])
    return str(signature.keyid)


def _envelope(signed: Signed) -> Envelope:
    # `from_dict` changes what it is given.
    envelope: Envelope = _library().Envelope.from_dict(json.loads(json.dumps(signed.data)))
    return envelope


def _library() -> Any:
    try:
        import cryptography  # noqa: F401 - the part of the library that signs
        from securesystemslib import dsse
    except ImportError as error:
        raise ConfigurationError(
            f"signatures need a package that is not installed: {error.name}",
            key="--key",
            remedy="pip install 'pytest-dura[signing]'",
        ) from None
    return dsse


def _key_error(file: Path, problem: str, expected: str) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(file),
        key="--key",
        expected=expected,
        remedy="make a pair of keys with `openssl genpkey -algorithm ed25519 -out private.pem` and "
        "`openssl pkey -in private.pem -pubout -out public.pem`",
    )


def _key_bytes(file: Path, expected: str) -> bytes:
    try:
        with file.open("rb") as stream:
            return stream.read(1 << 20)
    except OSError as error:
        problem = f"the key cannot be read: {error.strerror or error}"
        raise _key_error(file, problem, expected) from None


def check_private_key(file: Path) -> None:
    """Refuse a key that cannot sign, before anything is written.

    Raises:
        ConfigurationError: If the key or the extra ``signing`` cannot be used.
    """
    _signer(file)


def _signer(file: Path) -> Any:
    _library()
    from cryptography.hazmat.primitives.serialization import load_pem_private_key
    from securesystemslib.signer import CryptoSigner

    expected = "a private key in PEM: Ed25519, ECDSA or RSA"
    content = _key_bytes(file, expected)
    password = os.environ.get(PASSWORD)
    load = partial(load_pem_private_key, content)
    try:
        try:
            private = load(None)
        except TypeError:  # it is encrypted
            if password is None:
                problem = f"the private key is encrypted, and {PASSWORD} is not set"
                raise _key_error(file, problem, expected) from None
            private = load(password.encode())
        return CryptoSigner(private)
    except ValueError as error:  # the message may quote the password, but never the key
        wrong = "or the password is wrong" if password else "that can be used"
        problem = f"this is no private key {wrong} ({type(error).__name__})"
        raise _key_error(file, problem, expected) from None


def _public_key(file: Path) -> Key:
    _library()
    from cryptography.hazmat.primitives.serialization import load_pem_public_key
    from securesystemslib.signer import SSlibKey

    expected = "a public key in PEM: Ed25519, ECDSA or RSA"
    try:
        return SSlibKey.from_crypto(load_pem_public_key(_key_bytes(file, expected)))
    except ValueError as error:
        raise _key_error(
            file, f"this is no public key that can be used ({describe_error(error)})", expected
        ) from None


@dataclass(frozen=True)
class Signatures:
    """Result of the check of a bundle's signatures.

    Args:
        problems: What does not hold, as ``file: what``.
        lines: What is signed, by which key, and whether that was checked.
    """

    problems: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()


def check_signatures(
    directory: Path, keys: Sequence[Path] = (), *, gate: str = "", ended: str | None = None
) -> Signatures:
    """Check the envelopes beside a bundle.

    Args:
        directory: The bundle.
        gate: Result of the session's gate.
        ended: When the session ended, in ISO 8601; ``None`` for a record that cannot be read, of
            which no review is looked at.
        keys: Files with public keys, one of which must have signed each of them; without any, what
            they say is checked, and no signature.

    Raises:
        ConfigurationError: If the key or the extra ``signing`` cannot be used.
    """
    public = [_public_key(key) for key in keys]
    problems, lines = [], []
    if public and not os.path.lexists(directory / SIGNATURE_FILE):
        problems.append(f"{SIGNATURE_FILE}: missing; this bundle is not signed")
    for file in SIGNED_FILES:
        if not os.path.lexists(directory / file):
            continue
        try:
            signed = Signed.read(directory / file)
            if file == SIGNATURE_FILE:
                _check_covered(directory, signed)
                lines.append(f"{STATEMENT_FILE}, {_signers_text(signed, public)}")
            elif ended is not None:
                reviewed = _review_of(signed, directory, ended)
                lines.append(_review_line(reviewed, public, gate))
        except OSError as error:
            problems.append(f"{file}: cannot be read ({describe_error(error)})")
        except ValueError as error:
            problems.append(f"{file}: {error}")
        except Exception as error:  # whatever a damaged envelope does to the library
            problems.append(f"{file}: damaged ({describe_error(error)})")
    return Signatures(tuple(problems), tuple(lines))


def _signers_of(signed: Signed, public: Sequence[Key]) -> tuple[str, ...]:
    """Ids of all the given keys that signed it."""
    return tuple(key.keyid for key in public if _is_signed_by(signed, key))


def _is_signed_by(signed: Signed, key: Key) -> bool:
    from securesystemslib.exceptions import VerificationError

    try:
        return bool(_envelope(signed).verify([key], 1))
    except VerificationError:
        return False


def _signers_text(signed: Signed, public: Sequence[Key]) -> str:
    """Say which keys signed it, and whether that was checked.

    Raises:
        ValueError: If there are keys, and none of them did.
    """
    ids = _signers_of(signed, public) if public else signed.key_ids
    if not ids:
        raise ValueError("not signed by the key of --key")
    how = "checked" if public else "not checked: name the public key with --key"
    return f"signed by {', '.join(each[:_SHORT_ID] for each in ids)} ({how})"


def _review_line(reviewed: SignedReview, public: Sequence[Key], gate: str) -> str:
    """Say what a review decided, whose key signed it, and what that shows.

    Raises:
        ValueError: If there are keys, and none of them signed it.
    """
    review, signed = reviewed.review, reviewed.signed
    signers = _signers_text(signed, public)
    remarks = [reviewed.decision, *_gate_remark(review, gate), signers]
    if not public or reviewed.evidence is None:
        return "; ".join([*remarks, reviewed.independence()])
    producers = _signers_of(reviewed.evidence, public)
    remarks.append(reviewed.independence(_signers_of(signed, public), producers))
    named = ", ".join(each[:_SHORT_ID] for each in producers or reviewed.evidence.key_ids)
    how = "checked" if producers else "not checked: name its public key with --key as well"
    return "; ".join([*remarks, f"the evidence by {named} ({how})"])


def _check_covered(directory: Path, signed: Signed) -> None:
    """Refuse a signature of other files than those of the bundle.

    Raises:
        ValueError: If a file is another, or was added or removed.
        OSError: If a file of the bundle cannot be read.
    """
    expected = _signed_statement(directory)
    if signed.payload == expected:
        return
    theirs, ours = (_without_covering(payload) for payload in (signed.payload, expected))
    if theirs[0] != ours[0]:
        raise ValueError(f"of another {STATEMENT_FILE}")
    for file in _COVERING:
        if theirs[1].get(file) != ours[1].get(file):
            raise ValueError(
                f"of another {file}" if file in theirs[1] else f"it does not cover {file}"
            )
    raise ValueError("not written as `sign` writes it")


def _without_covering(payload: bytes) -> tuple[Any, dict[str, Any]]:
    """Split a signed statement into the bundle's own, and the subjects that `sign` adds."""
    statement = json.loads(payload)
    subjects = statement.pop("subject")
    added = {each["name"]: each for each in subjects if each["name"] in _COVERING}
    own = [each for each in subjects if each["name"] not in _COVERING]
    return {**statement, "subject": own}, added
