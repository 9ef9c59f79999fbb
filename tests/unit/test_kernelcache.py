# SPDX-License-Identifier: BSD-3-Clause
"""The kernel cache keeps what is whole, throws away what is not, and is never the reason for an error."""

import json
import os
import time

import pytest

from faultrecon.graph import compiled
from faultrecon.graph.compiled import Program
from faultrecon.storage import kernelcache

DIGEST = "a1" * 32
TEXT = """\
@part
def twice(x):
    return 2.0 * x

@kernel(float64(float64))
def shifted(x):
    return twice(x) + offset[0]
"""


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv(kernelcache.VARIABLE, str(tmp_path))
    compiled.forget()
    return tmp_path / "kernels"


def put(digest=DIGEST, text="content"):
    with kernelcache.preparing(digest) as entry:
        (entry / "sub").mkdir()
        (entry / "sub" / "file").write_text(text)


def test_what_was_put_is_found_by_its_hash_alone():
    assert kernelcache.stored(DIGEST) is None
    put()
    assert (kernelcache.stored(DIGEST) / "sub" / "file").read_text() == "content"
    assert kernelcache.stored("b2" * 32) is None


@pytest.mark.parametrize("damage", ["flip", "truncate", "remove", "add", "list"])
def test_a_damaged_entry_is_thrown_away(damage):
    put()
    entry = kernelcache.stored(DIGEST)
    file = entry / "sub" / "file"
    match damage:
        case "flip":
            file.write_text("cOntent")
        case "truncate":
            file.write_text("")
        case "remove":
            file.unlink()
        case "add":
            (entry / "stranger").write_text("")
        case "list":
            (entry / kernelcache.LIST).write_text("{")
    assert kernelcache.stored(DIGEST) is None
    assert not entry.exists()


def test_of_two_that_prepare_the_same_entry_the_first_stays_and_none_fails(cache):
    with kernelcache.preparing(DIGEST) as slow:
        (slow / "file").write_text("slow")
        with kernelcache.preparing(DIGEST) as quick:
            (quick / "file").write_text("quick")
    assert (kernelcache.stored(DIGEST) / "file").read_text() == "quick"
    assert [f.name for f in cache.iterdir()] == [DIGEST]


def test_a_preparation_that_fails_leaves_nothing(cache):
    with pytest.raises(RuntimeError, match="compiler"), kernelcache.preparing(DIGEST):
        raise RuntimeError("compiler")
    assert list(cache.iterdir()) == []


def test_an_empty_variable_keeps_nothing_on_disk(monkeypatch):
    monkeypatch.setenv(kernelcache.VARIABLE, "")
    with kernelcache.preparing(DIGEST) as entry:
        assert entry is None
    assert kernelcache.stored(DIGEST) is None


def test_a_folder_that_cannot_be_made_keeps_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(kernelcache.VARIABLE, str(tmp_path / "file"))
    assert kernelcache.folder() is None
    assert compiled.load(Program(TEXT, {"offset": [1.0]}))["shifted"](3.0) == 7.0


def test_a_folder_that_cannot_be_written_keeps_nothing(cache, monkeypatch):
    cache.mkdir()
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert kernelcache.folder() is None


def test_a_folder_that_others_can_write_to_is_not_trusted(cache):
    cache.mkdir()
    cache.chmod(0o777)
    # Windows has access control lists instead of these bits, and no user numbers.
    assert kernelcache.folder() == (None if hasattr(os, "getuid") else cache)


def test_without_the_variable_the_cache_is_the_users_own(monkeypatch, tmp_path):
    monkeypatch.delenv(kernelcache.VARIABLE)
    monkeypatch.setattr(kernelcache, "_user_cache", lambda: tmp_path / "user")
    assert kernelcache.folder() == tmp_path / "user" / "faultrecon" / "kernels"


def test_the_entries_unused_for_longest_go_first(monkeypatch, cache):
    monkeypatch.setattr(kernelcache, "KEPT", 2)
    for i, digest in enumerate(("a" * 64, "b" * 64)):
        put(digest)
        os.utime(cache / digest, (i, i))
    kernelcache.stored("a" * 64)  # used now
    put("c" * 64)
    assert {f.name[0] for f in cache.iterdir()} == {"a", "c"}


def test_preparations_whose_process_died_are_swept_up(cache):
    put()
    (cache / ".dead.x").mkdir()
    old = time.time() - 2 * kernelcache.ABANDONED
    os.utime(cache / ".dead.x", (old, old))
    put("c" * 64)
    assert not (cache / ".dead.x").exists()


# ------------------------------------------------------------ programs on disk


def test_a_program_is_compiled_once_and_then_fetched(cache):
    program = Program(TEXT, {"offset": [1.0]})
    assert compiled.where(program) == ""
    assert compiled.load(program)["shifted"](3.0) == 7.0
    assert compiled.where(program) == "memory"
    compiled.forget()
    assert compiled.where(program) == "disk"
    kernel = compiled.load(program)["shifted"]
    assert kernel(3.0) == 7.0
    assert sum(kernel.stats.cache_hits.values()) == 1
    assert kernelcache.stored(program.digest) is not None  # fetching changes nothing in the entry


def test_a_damaged_program_on_disk_is_compiled_anew():
    program = Program(TEXT, {"offset": [2.0]})
    compiled.load(program)
    compiled.forget()
    code = next(kernelcache.stored(program.digest).rglob("*shifted*.nbc"))
    damaged = bytearray(code.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    code.write_bytes(damaged)
    assert compiled.load(program)["shifted"](3.0) == 8.0


def test_a_program_that_the_list_vouches_for_but_numba_cannot_read_is_compiled_anew():
    program = Program(TEXT, {"offset": [3.0]})
    compiled.load(program)
    compiled.forget()
    entry = kernelcache.stored(program.digest)
    for index in entry.rglob("*.nbi"):
        index.write_bytes(b"nothing that can be read")
    (entry / kernelcache.LIST).write_text(json.dumps(kernelcache._contents(entry)))
    assert compiled.load(program)["shifted"](3.0) == 9.0
    compiled.forget()
    assert compiled.load(program)["shifted"](3.0) == 9.0


def test_other_constants_are_another_program():
    one, other = Program(TEXT, {"offset": [1.0]}), Program(TEXT, {"offset": [1.0 + 2**-52]})
    assert one.digest != other.digest
    assert one.digest == Program(TEXT, {"offset": [1.0]}).digest
