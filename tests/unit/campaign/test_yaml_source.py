"""Reading YAML: what is accepted, with lines, and one clear message for everything else."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import yaml

from pytest_dura import ConfigurationError
from pytest_dura.library import builtin_paths, parse_yaml, read_yaml
from pytest_dura.library.documents import MAX_BYTES


def refused(path: Path) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        read_yaml(path)
    assert caught.value.__suppress_context__ or caught.value.__context__ is None
    return caught.value


def test_plain_data_and_the_line_of_each_key(tmp_path: Path) -> None:
    file = tmp_path / "some.yaml"
    file.write_text("# head\nname: a\nworld:\n  list:\n    - x: 1\n    - {y: 2.5}\n  none: null\n")
    document = read_yaml(file)
    assert document.data == {
        "name": "a",
        "world": {"list": [{"x": 1}, {"y": 2.5}], "none": None},
    }
    assert document.line_of("name") == 2
    assert document.line_of("world.list.1.y") == 6
    assert document.line_of("world.none") == 7


@pytest.mark.of_guest  # the house has no built-in files
def test_both_parsers_read_the_same_of_each_file_of_this_package() -> None:
    files = [file for folder in builtin_paths() for file in folder.rglob("*.yaml")]
    assert files
    for file in files:
        own, quick = read_yaml(file), read_yaml(file, trusted=True)
        assert repr(quick.data) == repr(own.data)
        assert quick.lines == own.lines


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML has no libyaml here")
@pytest.mark.parametrize(
    "text", ["a: [*b]", "a: &x [*x]", "a: " + "[" * 40 + "]" * 40, "a\n---\nb"]
)
def test_the_quick_parser_refuses_the_same(text: str) -> None:
    problems = []
    for trusted in (False, True):
        with pytest.raises(ConfigurationError) as caught:
            parse_yaml(text, "f", trusted=trusted)
        problems.append((caught.value.problem, caught.value.line))
    assert problems[0] == problems[1]


def test_a_key_that_is_not_there_has_the_line_of_what_it_would_stand_in() -> None:
    document = parse_yaml("name: a\nworld:\n  x: 1\n", "f")
    assert document.line_of("world.y.z") == 2
    assert document.line_of("nothing") is None


def test_a_key_with_dots_has_a_line() -> None:
    document = parse_yaml("variation:\n  world.a.b:\n    min: 1\n", "f")
    assert document.line_of("variation.world.a.b.min") == 3


@pytest.mark.parametrize(
    "text, value",
    [
        ("yes", "yes"),
        ("on", "on"),
        ("12:30", "12:30"),
        ("2026-01-01", "2026-01-01"),
        ("010", 10),
        ("0o10", 8),
        ("0xff", 255),
        ("1e3", 1000.0),
        ("-.5", -0.5),
        ("1_000", "1_000"),
        ("True", True),
        ("~", None),
        ("", None),
        ("'3'", "3"),
        ("!!str 3", "3"),
        ("!!float 3", 3.0),
        ("none", "none"),
    ],
)
def test_scalars_follow_yaml_1_2(text: str, value: object) -> None:
    found = parse_yaml(f"key: {text}\n", "f").data["key"]
    assert found == value
    assert type(found) is type(value)


def test_few_aliases_are_welcome() -> None:
    document = parse_yaml("a: &x {b: 1}\nc: [*x, *x]\n", "f")
    assert document.data == {"a": {"b": 1}, "c": [{"b": 1}, {"b": 1}]}


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_bytes(b"\xef\xbb\xbfname: a\n")
    assert read_yaml(file).data == {"name": "a"}


@pytest.mark.parametrize(
    "text", ["", "\n\n", "# only a comment\n", "---\n", "---\n...\n", "null\n"]
)
def test_an_empty_file(tmp_path: Path, text: str) -> None:
    file = tmp_path / "empty.yaml"
    file.write_text(text)
    error = refused(file)
    assert error.file == str(file)
    assert error.line == 1
    assert "empty" in error.problem
    assert error.remedy is not None
    assert error.expected is not None


def test_a_missing_file(tmp_path: Path) -> None:
    error = refused(tmp_path / "missing.yaml")
    assert error.found == "nothing at this path"
    assert "check the path" in str(error)


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    assert refused(tmp_path).found == "a directory"


@pytest.mark.parametrize(
    "raw, line",
    [
        (bytes(range(256)), 1),
        (b"\x89PNG\r\n\x1a\n\0\0", 3),
        (b"name: a\nworld: \xff\xfe\n", 2),
        (b"name: a\n\nworld: \0\n", 3),
        ("name: ä\n".encode("utf-16"), 1),
    ],
)
def test_a_binary_file(tmp_path: Path, raw: bytes, line: int) -> None:
    file = tmp_path / "binary.yaml"
    file.write_bytes(raw)
    error = refused(file)
    assert "not UTF-8 text" in error.problem
    assert error.line == line
    assert "save it as UTF-8" in str(error.remedy)


def test_control_characters_are_refused_with_the_file(tmp_path: Path) -> None:
    file = tmp_path / "control.yaml"
    file.write_text("name: \x07\n")
    error = refused(file)
    assert error.problem == "the file is not valid YAML"
    assert error.file == str(file)


def test_a_file_above_the_limit(tmp_path: Path) -> None:
    file = tmp_path / "large.yaml"
    file.write_bytes(b"a: " + b"x" * MAX_BYTES)
    error = refused(file)
    assert str(MAX_BYTES) in str(error.expected)
    assert f"{MAX_BYTES + 3} bytes" in str(error.found)


@pytest.mark.parametrize(
    "text, line",
    [
        ("name: a\nworld: [1, 2\nx: 3\n", 3),
        ("name: a\n\tworld: 1\n", 2),
        ("name: 'a\n", 2),
        ("name: a\nworld: b: c\n", 2),
        ("name: *nowhere\n", 1),
        ("a: @x\n", 1),
    ],
)
def test_a_syntax_error_names_its_line(tmp_path: Path, text: str, line: int) -> None:
    file = tmp_path / "syntax.yaml"
    file.write_text(text)
    error = refused(file)
    assert error.problem == "the file is not valid YAML"
    assert error.line == line
    assert error.found
    assert "column" in str(error.remedy)


def test_a_key_that_stands_twice_names_both_lines() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_yaml("world:\n  a: 1\n  b: 2\n  a: 3\n", "f.yaml")
    assert caught.value.key == "world.a"
    assert caught.value.line == 4
    assert "lines 2 and 4" in str(caught.value.found)


@pytest.mark.parametrize(
    "value, tag",
    [
        ("!!python/object/apply:os.system ['echo hacked']", "python/object/apply:os.system"),
        ("!!python/name:os.system ''", "python/name:os.system"),
        ("!mine {a: 1}", "!mine"),
        ("!!binary aGVsbG8=", "!!binary"),
        ("!!set {a}", "!!set"),
        ("!!timestamp 2026-01-01", "!!timestamp"),
    ],
)
def test_an_object_tag(value: str, tag: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_yaml(f"name: a\nworld:\n  x: {value}\n", "f.yaml")
    error = caught.value
    assert (error.file, error.line, error.key) == ("f.yaml", 3, "world.x")
    assert tag in str(error.found)
    assert "remove the tag" in str(error.remedy)


def bomb(levels: int) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "\n".join(lines)


def test_a_bomb_of_aliases_is_refused_before_it_grows() -> None:
    start = time.process_time()
    with pytest.raises(ConfigurationError) as caught:
        parse_yaml(bomb(30), "bomb.yaml")
    assert time.process_time() - start < 1.0
    assert "aliases" in caught.value.problem
    assert caught.value.line == 5
    assert "without nested aliases" in str(caught.value.remedy)


def test_an_alias_of_what_it_stands_in() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_yaml("a: &x\n  - 1\n  - *x\n", "f.yaml")
    assert caught.value.line == 3
    assert "*x" in str(caught.value.found)


def test_merge_keys_are_named_as_such() -> None:
    with pytest.raises(ConfigurationError, match="merge keys are not supported") as caught:
        parse_yaml("a: &x {b: 1}\nc:\n  <<: *x\n", "f.yaml")
    assert (caught.value.line, caught.value.key) == (3, "c")


@pytest.mark.parametrize("opening", ["[", "{a: ", "- "])
def test_deep_nesting(opening: str) -> None:
    with pytest.raises(ConfigurationError, match="nested too deeply"):
        parse_yaml("a:\n  " + opening * 5000, "f.yaml")


def test_several_documents() -> None:
    with pytest.raises(ConfigurationError, match="several YAML documents") as caught:
        parse_yaml("a: 1\n---\nb: 2\n", "f.yaml")
    assert caught.value.line == 2


@pytest.mark.parametrize(
    "text, found", [("- a\n- b\n", "a list"), ("just text\n", "a single value")]
)
def test_not_a_mapping(text: str, found: str) -> None:
    with pytest.raises(ConfigurationError, match="does not hold a mapping") as caught:
        parse_yaml(text, "f.yaml")
    assert caught.value.found == found


@pytest.mark.parametrize(
    "number", [".nan", ".inf", "-.INF", "1e999", "9" * 40, "9" * 5000, "!!int x"]
)
def test_numbers_that_are_not_finite(number: str) -> None:
    with pytest.raises(ConfigurationError, match="not a finite number") as caught:
        parse_yaml(f"a:\n  b: {number}\n", "f.yaml")
    assert (caught.value.line, caught.value.key) == (2, "a.b")


@pytest.mark.parametrize("key", ["1", "true", "null", "[a]", "? [a]"])
def test_keys_must_be_text(key: str) -> None:
    with pytest.raises(ConfigurationError, match="a key must be text"):
        parse_yaml(f"{key}: 1\n", "f.yaml")
