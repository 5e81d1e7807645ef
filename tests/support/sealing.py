"""Bundles that somebody altered who knows how manifests are made."""

from __future__ import annotations

import json

from pytest_dura.evidence import MANIFEST_FILE, file_entry, files_below, manifest_text
from pytest_dura.evidence.bundle import RESUME_FOLDER


def seal(bundle):
    """A manifest that agrees with whatever lies there now, without the episodes kept to resume."""
    names = [
        name
        for name in files_below(bundle)
        if name.partition("/")[0] not in (MANIFEST_FILE, RESUME_FOLDER)
    ]
    (bundle / MANIFEST_FILE).write_text(
        manifest_text({name: file_entry(bundle / name) for name in names})
    )


def alter(bundle, change):
    """Change the record, and seal the bundle."""
    file = bundle / "evidence.json"
    record = json.loads(file.read_text())
    change(record)
    file.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    seal(bundle)
