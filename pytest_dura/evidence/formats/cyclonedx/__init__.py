"""``cyclonedx.json``: CycloneDX 1.6 declarations, for tools that keep a product's attestations.

The requirements are a standard of their own; each verdict is a claim on the component under test,
with evidence that points into ``evidence.json``; an attestation maps requirements to claims.

What a reader may conclude, and what not:

- A violated verdict is a counter claim. An undecided one is a claim that says no more than that.
- ``conformance.score`` is 1, 0 or absent, never a share: a share would let many cases outweigh the
  one in which a requirement is violated. It is 1 only where the session is complete, every verdict
  on the requirement is supported, none is waived, and each planned case that declares it has one.
  It is 0 where a verdict is violated, or a search falsified it, and no waiver excuses that. Where
  it is neither, there is none: conformance is not attested, and the rationale says why. Cells that
  no scenario and no test declares do not count.
- ``confidence`` is left out: it is the belief in the claim, which a tool has not. The confidence of
  an interval stands with its bound and its n in the evidence.
- ``affirmation`` is left out: nobody has reviewed what is generated.
- A waiver is recorded with the evidence. It excuses a verdict; it mitigates nothing.
"""

from pytest_dura.evidence.formats.cyclonedx.document import FILE, render
from pytest_dura.evidence.formats.cyclonedx.reading import (
    broken_references,
    dangling,
    read_counts,
)

__all__ = ["FILE", "broken_references", "dangling", "read_counts", "render"]
