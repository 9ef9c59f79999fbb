# SPDX-License-Identifier: BSD-3-Clause
"""A checkpoint gives back every bit, is written whole or not at all, and is refused where it does not belong."""

import json
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from faultrecon.finding import InputError
from faultrecon.storage import checkpoint
from faultrecon.storage.checkpoint import demand_same, load, save
from faultrecon.storage.hashing import canonical_digest


def bits(value):
    """A value whose equality is equality of types and bits."""
    if isinstance(value, float):
        return "float", struct.pack("<d", value)
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, list):
        return [bits(v) for v in value]
    if isinstance(value, dict):
        return {k: bits(v) for k, v in value.items()}
    return type(value).__name__, value


FLOATS = st.floats(allow_nan=True, allow_infinity=True) | st.integers(0, 2**64 - 1).map(
    lambda i: struct.unpack("<d", struct.pack("<Q", i))[0]
)
DTYPES = st.sampled_from(["f8", "bool", "i1", "u1", "i4", "i8", "u8"])
ARRAYS = hnp.arrays(DTYPES, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
KEYS = st.text(max_size=6) | st.sampled_from(["$float", "$int", "$array", "$$x", "$"])
LEAVES = st.none() | st.booleans() | st.integers(-(10**40), 10**40) | FLOATS | st.text(max_size=8) | ARRAYS
VALUES = st.recursive(LEAVES, lambda v: st.lists(v, max_size=4) | st.dictionaries(KEYS, v, max_size=4), max_leaves=12)


@settings(deadline=None, max_examples=200)
@given(of=st.dictionaries(KEYS, VALUES, max_size=3), content=st.dictionaries(KEYS, VALUES, max_size=5))
def test_any_nested_plain_value_comes_back_bit_by_bit(tmp_path_factory, of, content):
    file = tmp_path_factory.getbasetemp() / "round.json"
    save(file, of, content)
    found = load(file)
    assert bits(dict(found.of)) == bits(of) and bits(dict(found.content)) == bits(content)


def test_a_checkpoint_is_ordinary_json(tmp_path):
    save(tmp_path / "c.json", {}, {"x": [1.5, math.nan, -math.inf], "a": np.array([[0.1]])})
    document = json.loads((tmp_path / "c.json").read_text("ascii"), parse_constant=lambda name: pytest.fail(name))
    assert document["kind"] == "faultrecon-checkpoint" and document["schema"] == 1
    assert document["content"]["x"] == [{"$float": "0x1.8000000000000p+0"}, {"$float": "nan"}, {"$float": "-inf"}]
    assert document["content"]["a"] == {"$array": "float64", "shape": [1, 1], "values": [(0.1).hex()]}


@pytest.mark.parametrize(
    "value", [object(), {1: 2}, (1, 2), np.float64(1.0), np.array(["a"]), np.array([1.0], ">f8"), {1, 2}, b"x"]
)
def test_what_is_no_plain_value_is_an_error_of_the_program_and_leaves_no_file(tmp_path, value):
    with pytest.raises(TypeError, match="a checkpoint holds no"):
        save(tmp_path / "c.json", {}, {"x": value})
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_checkpoint_before(tmp_path, monkeypatch):
    file = tmp_path / "c.json"
    save(file, {}, {"row": 1})

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint.os, "fsync", full)
    with pytest.raises(InputError, match="No space left"):
        save(file, {}, {"row": 2})
    assert load(file).content == {"row": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["c.json"]


@pytest.mark.parametrize("position", range(0, 400, 7))
def test_a_changed_character_is_found(tmp_path, position):
    file = tmp_path / "c.json"
    save(file, {"run": "a file"}, {"state": np.arange(6.0), "seq": 12})
    text = bytearray(file.read_bytes())
    k = position % (len(text) - 1)
    text[k] = text[k] + 1 if text[k] != ord("z") else text[k] - 1
    file.write_bytes(text)
    with pytest.raises(InputError, match=r"is damaged|is no checkpoint|schema"):
        load(file)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "{}", "\x00", '{"kind": "faultrecon-design"}', "[" * 10_000])
def test_other_files_are_no_checkpoints(tmp_path, text):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(InputError, match=r"c\.json: is (damaged|no checkpoint)"):
        load(tmp_path / "c.json")


def test_the_rest_of_a_checkpoint_that_was_cut_off_is_missed(tmp_path):
    file = tmp_path / "c.json"
    save(file, {}, {"row": 1})
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(InputError, match="is damaged"):
        load(file)


def test_a_newer_checkpoint_says_so(tmp_path):
    file = tmp_path / "c.json"
    save(file, {}, {})
    document = json.loads(file.read_text()) | {"schema": 2, "written_by": "faultrecon 9.0"}
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"schema 2.*faultrecon 9\.0.*update faultrecon"):
        load(file)


def test_wrong_content_under_a_right_digest_is_damage_all_the_same(tmp_path):
    file = tmp_path / "c.json"
    save(file, {}, {})
    for content in (
        {"$float": "x"},
        {"$array": "object", "shape": [1], "values": [1]},
        {"$array": "bool", "shape": [2]},
    ):
        document = json.loads(file.read_text()) | {"content": {"x": content}}
        document.pop("sha256", None)
        file.write_text(json.dumps(document | {"sha256": canonical_digest(document)}))
        with pytest.raises(InputError, match="is damaged"):
            load(file)


def test_only_what_a_kill_left_of_this_very_file_is_swept_away(tmp_path):
    for name in (".c.0123456789ab.json", ".cc.0123456789ab.json", ".c.json", "c.json", ".c.0123456789ab.csv"):
        (tmp_path / name).write_text("")
    checkpoint.sweep(tmp_path / "c.json")
    assert {p.name for p in tmp_path.iterdir()} == {
        ".cc.0123456789ab.json",
        ".c.json",
        "c.json",
        ".c.0123456789ab.csv",
    }


def test_an_absent_file_and_a_folder_are_told_apart(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "c.json")
    with pytest.raises(InputError, match="cannot be read"):
        load(tmp_path)


def test_a_checkpoint_of_another_run_is_refused_with_the_difference():
    demand_same("c.json", {"a": 1}, {"a": 1})
    with pytest.raises(InputError, match=r"another run: log is abc there, def here; every is 2 there, absent here"):
        demand_same("c.json", {"log": "abc", "every": 2, "same": 0}, {"log": "def", "same": 0})
