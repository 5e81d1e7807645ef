"""Files are written whole or not at all, and nothing is left of what was begun."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from pytest_dura.core import WrittenFile, replace_file, temporary_prefix


@pytest.mark.parametrize("durable", [False, True])
def test_what_is_written_has_the_size_and_digest_that_are_told(
    tmp_path: Path, *, durable: bool
) -> None:
    file = tmp_path / "deep" / "file"
    told = replace_file(file, ["é", b"\x00", "\udcff"], durable=durable)
    data = file.read_bytes()
    assert data == "é".encode() + b"\x00\\udcff"
    assert told == WrittenFile(hashlib.sha256(data).hexdigest(), len(data))
    assert file.stat().st_mode & 0o777 == 0o644


def test_whatever_stops_the_writing_leaves_the_old_file_alone(tmp_path: Path) -> None:
    seen = []

    def stopped() -> Iterator[str]:
        yield "half"
        seen.extend(sorted(one.name for one in tmp_path.iterdir()))
        raise KeyboardInterrupt

    replace_file(tmp_path / "file", ["old"], durable=False)
    with pytest.raises(KeyboardInterrupt):
        replace_file(tmp_path / "file", stopped(), durable=False)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("file", "old")]
    assert seen[0].startswith(temporary_prefix("file")), "what a kill would leave has this name"


def test_a_link_is_replaced_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "outside").write_text("mine")
    (tmp_path / "file").symlink_to(tmp_path / "outside")
    replace_file(tmp_path / "file", ["new"], durable=False)
    assert (tmp_path / "outside").read_text() == "mine"
    assert not (tmp_path / "file").is_symlink()
