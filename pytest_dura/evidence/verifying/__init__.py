"""Verifying a bundle: read back, hashes and references followed, counts of all formats compared."""

from pytest_dura.evidence.verifying.bundle import Verification, verify_bundle

__all__ = ["Verification", "verify_bundle"]
