"""Sign a bundle, and record a review of it: DSSE envelopes around in-toto statements.

``sign`` leaves two files beside a bundle. Both are optional, and neither is in its manifest:

- ``test-result.intoto.dsse.json`` holds the bundle's statement on its record, byte for byte. The
  record's SHA-256 is a subject of that statement, and all other files follow from the record.
- ``review.dsse.json`` holds a statement on the record, too: who reviewed it, when, what, and the
  decision. Reports that are rendered with it no longer say "unreviewed".

To read them needs nothing; to make or check a signature needs the extra ``signing``. Envelopes are
those of DSSE 1.0 (https://github.com/secure-systems-lab/dsse), so that other tools check them.
"""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, StringConstraints, ValidationError

from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.evidence.entry import Entry
from pytest_dura.evidence.files import (
    REVIEW_FILE,
    SIGNATURE_FILE,
    SIGNED_FILES,
    file_entry,
    write_file,
)

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
_SHORT_ID = 16
"""Characters of a key's id that are shown."""
_MAX_BYTES = 16 << 20
"""Size of the largest envelope that is read."""

_Text = Annotated[str, StringConstraints(min_length=1, max_length=2000, strip_whitespace=True)]


class Review(Entry):
    """Review of a session's evidence by a person, as in ``review.yaml``."""

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
    """Content of an envelope, which nobody checked.

    Args:
        payload: The signed bytes.
        key_ids: Ids of the keys that are said to have signed it.
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
            data = json.loads(file.read_bytes())
            if data["payloadType"] != _PAYLOAD_TYPE:
                raise ValueError("not of an in-toto statement")
            key_ids = tuple(str(each["keyid"]) for each in data["signatures"])
            payload = base64.b64decode(data["payload"], validate=True)
        except (LookupError, TypeError, RecursionError, AttributeError) as error:
            raise ValueError(f"no envelope ({describe_error(error)})") from None
        if not key_ids:
            raise ValueError("without a signature")
        return cls(payload, key_ids, data)


def read_review(directory: Path) -> Review | None:
    """Return the review that lies beside a bundle, if it is one of this very record.

    Its signature is not checked here; ``verify --key`` does that.
    """
    try:
        return _review_of(Signed.read(directory / REVIEW_FILE), directory)
    except (OSError, ValueError):
        return None


def _review_of(signed: Signed, directory: Path) -> Review:
    """The review in an envelope.

    Raises:
        ValueError: If it holds none, or one of another record.
    """
    try:
        statement = json.loads(signed.payload)
        predicate_type, subjects = statement["predicateType"], statement["subject"]
        review = Review.model_validate(statement["predicate"])
    except (LookupError, TypeError, RecursionError, ValidationError) as error:
        raise ValueError(f"no review ({describe_error(error)})") from None
    if predicate_type != _REVIEW:
        raise ValueError("no review")
    if subjects != [_subject(directory)]:
        raise ValueError(f"a review of another {_RECORD_FILE}")
    return review


def _subject(directory: Path) -> dict[str, Any]:
    digest = file_entry(directory / _RECORD_FILE)["sha256"]
    return {"name": _RECORD_FILE, "digest": {"sha256": digest}}


def write_review(directory: Path, review: Review, key: Path) -> None:
    """Sign a review of a bundle's record, and write it beside the bundle.

    Raises:
        ConfigurationError: If the key or the extra ``signing`` cannot be used.
    """
    statement = {
        "_type": _STATEMENT,
        "subject": [_subject(directory)],
        "predicateType": _REVIEW,
        "predicate": review.to_json(),
    }
    payload = (json.dumps(statement, indent=1, ensure_ascii=False) + "\n").encode()
    _write_signed(directory / REVIEW_FILE, payload, key)


def sign_statement(directory: Path, key: Path) -> str:
    """Sign a bundle's statement, and return the key's id.

    An envelope that already holds this statement gets one signature more.

    Raises:
        ConfigurationError: If the key or the extra ``signing`` cannot be used.
    """
    return _write_signed(directory / SIGNATURE_FILE, (directory / STATEMENT_FILE).read_bytes(), key)


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


def check_signatures(directory: Path, keys: Sequence[Path] = ()) -> Signatures:
    """Check the envelopes beside a bundle.

    Args:
        directory: The bundle.
        keys: Files with public keys, one of which must have signed each of them; without any, what
            they say is checked, and no signature.

    Raises:
        ConfigurationError: If the key or the extra ``signing`` cannot be used.
    """
    public = [_public_key(key) for key in keys]
    problems, lines = [], []
    if public and not os.path.lexists(directory / SIGNATURE_FILE):
        problems.append(f"{SIGNATURE_FILE}: missing; this bundle is not signed")
    for name in SIGNED_FILES:
        if not os.path.lexists(directory / name):
            continue
        try:
            signed = Signed.read(directory / name)
            about = _about(directory, name, signed)
            by = ", ".join(each[:_SHORT_ID] for each in signed.key_ids)
            how = "not checked: name the public key with --key"
            if public:
                by, how = _signer_of(signed, public)[:_SHORT_ID], "checked"
            lines.append(f"{about}, signed by {by} ({how})")
        except OSError as error:
            problems.append(f"{name}: cannot be read ({describe_error(error)})")
        except ValueError as error:
            problems.append(f"{name}: {error}")
        except Exception as error:  # whatever a damaged envelope does to the library
            problems.append(f"{name}: damaged ({describe_error(error)})")
    return Signatures(tuple(problems), tuple(lines))


def _signer_of(signed: Signed, public: list[Key]) -> str:
    """Id of a key that signed it.

    Raises:
        ValueError: If none of them did.
    """
    from securesystemslib.exceptions import VerificationError

    try:
        return next(iter(_envelope(signed).verify(public, 1)))
    except VerificationError:
        raise ValueError("not signed by the key of --key") from None


def _about(directory: Path, name: str, signed: Signed) -> str:
    """What an envelope says.

    Raises:
        ValueError: If it is about something else than this bundle.
        OSError: If a file of the bundle cannot be read.
    """
    if name == REVIEW_FILE:
        review = _review_of(signed, directory)
        return f"{review.decision} by {review.who} on {review.when}"
    if signed.payload != (directory / STATEMENT_FILE).read_bytes():
        raise ValueError(f"of another {STATEMENT_FILE}")
    return STATEMENT_FILE
