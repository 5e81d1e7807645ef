import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pytest_dura.evidence import MANIFEST_FILE, file_entry, manifest_problems, manifest_text

FILES = {
    "evidence.json": b'{"status": "complete"}\n',
    "episodes/a-0.mcap": bytes(range(256)),
    "empty.md": b"",
}


@pytest.fixture
def bundle(tmp_path):
    for name, data in FILES.items():
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(data)
    listed = {name: file_entry(tmp_path / name) for name in FILES}
    (tmp_path / MANIFEST_FILE).write_text(manifest_text(listed))
    return tmp_path


def test_an_untouched_bundle_has_no_problem(bundle):
    assert list(manifest_problems(bundle)) == []


@settings(
    derandomize=True,
    deadline=None,
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.data())
def test_one_flipped_bit_anywhere_is_found(bundle, data):
    name = data.draw(st.sampled_from(["evidence.json", "episodes/a-0.mcap", MANIFEST_FILE]))
    file = bundle / name
    before = file.read_bytes()
    place = data.draw(st.integers(0, len(before) - 1))
    bit = 1 << data.draw(st.integers(0, 7))
    file.write_bytes(before[:place] + bytes([before[place] ^ bit]) + before[place + 1 :])
    try:
        assert list(manifest_problems(bundle))
    finally:
        file.write_bytes(before)


@pytest.mark.parametrize("name", [*FILES, MANIFEST_FILE])
def test_a_file_that_is_gone_is_found(bundle, name):
    (bundle / name).unlink()
    assert any(one.startswith(name) for one in manifest_problems(bundle))


@pytest.mark.parametrize("name", ["more.txt", ".hidden", "episodes/b-1.mcap", "deep/er/file"])
def test_a_file_that_nobody_listed_is_found(bundle, name):
    (bundle / name).parent.mkdir(parents=True, exist_ok=True)
    (bundle / name).write_text("")
    assert list(manifest_problems(bundle)) == [f"{name}: not in the manifest"]


def test_a_link_in_the_place_of_a_file_is_found_though_its_content_is_the_same(bundle, tmp_path):
    elsewhere = tmp_path.parent / "elsewhere.json"
    (bundle / "evidence.json").rename(elsewhere)
    (bundle / "evidence.json").symlink_to(elsewhere)
    (problem,) = manifest_problems(bundle)
    assert problem.startswith("evidence.json: a link")


def test_a_manifest_that_was_written_anew_for_a_shorter_list_is_still_compared_with_the_files(
    bundle,
):
    listed = json.loads((bundle / MANIFEST_FILE).read_text())["files"]
    del listed["empty.md"]
    (bundle / MANIFEST_FILE).write_text(manifest_text(listed))
    assert list(manifest_problems(bundle)) == ["empty.md: not in the manifest"]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"files": 3}', '{"files": {"a": 1}}', "\udcff"])
def test_a_damaged_manifest_is_one_problem_and_no_traceback(bundle, text):
    (bundle / MANIFEST_FILE).write_text(text, errors="surrogateescape")
    (problem,) = manifest_problems(bundle)
    assert problem.startswith(f"{MANIFEST_FILE}: damaged")
