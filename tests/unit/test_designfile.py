# SPDX-License-Identifier: BSD-3-Clause
import copy
import dataclasses
import errno
import json
import os
import pathlib
import random
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.certificate import Certificate, load_certificate
from faultrecon.io.designfile import design_document, read_design, write_design
from faultrecon.io.plantfile import parse_plant
from faultrecon.io.template import TEMPLATE

PLANT = parse_plant(TEMPLATE, "template.toml")


@pytest.fixture(scope="module")
def design():
    return fr.design(PLANT)


@pytest.fixture(scope="module")
def document(design):
    return json.loads(json.dumps(design_document(design)))


@pytest.fixture
def stored(document, tmp_path):
    """Writes a changed copy of the design document; `change` gets the copy."""

    def write(change):
        changed = copy.deepcopy(document)
        change(changed)
        path = tmp_path / "design.json"
        path.write_text(json.dumps(changed), encoding="utf-8")
        return path

    return write


def sealed(document):
    """The document with digests that fit whatever it says now."""
    made = Certificate.from_document(document)
    document["certificate"]["digests"] = made.current_digests()


def refused(path, plant=None):
    with pytest.raises(fr.InputError) as caught:
        read_design(path, plant)
    message = str(caught.value)
    assert message.startswith(str(path)), "every complaint names the file"
    return message


def log(seed=0, rows=200):
    """A synthetic log: t, u, y with a step on position_b."""
    r = np.random.default_rng(seed)
    y = r.normal(0, 1e-3, (rows, 2))
    y[rows // 2 :, 1] += 0.01
    return 0.01 * np.arange(rows), r.normal(0, 1, (rows, 1)), y


# ---------------------------------------------------------------- round trip


def test_a_design_that_was_saved_and_loaded_is_the_same_to_the_last_bit(design, tmp_path):
    fr.save(design, tmp_path / "d.json")
    again = fr.load(tmp_path / "d.json")
    assert isinstance(again, fr.Design) and again.certificate is not None and design.certificate is not None
    assert set(again.gains) == set(design.gains)
    assert all(again.gains[k].tobytes() == design.gains[k].tobytes() for k in design.gains)
    assert (again.optimum, again.level, again.floor) == (design.optimum, design.level, design.floor)
    assert again.plant.digest() == design.plant.digest()
    assert again.certificate.digests == design.certificate.digests == again.certificate.current_digests()
    assert again.report() == design.report()
    fr.save(again, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "d.json").read_bytes()


def test_a_loaded_design_makes_the_same_trace_of_a_log(design, tmp_path):
    fr.save(design, tmp_path / "d.json")
    again = fr.load(tmp_path / "d.json", plant=PLANT)
    assert isinstance(again, fr.Design)
    first, second = (d.estimator(0.01).replay(*log()) for d in (design, again))
    for name in ("fault", "state", "corrected", "ok"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_a_design_without_certificate_loads_and_claims_nothing(stored):
    path = stored(lambda d: d.update(certificate=None))
    bare = read_design(path)
    assert (bare.certificate, bare.level, bare.verification) == (None, None, None)
    assert "nothing is claimed" in bare.report()
    with pytest.raises(fr.InputError, match="carries no certificate"):
        fr.verify(str(path))


# ---------------------------------------------------------------- another plant


@pytest.mark.parametrize(
    ("old", "new", "difference"),
    [
        ("-10.0", "-11.0", r"matrices.A[1][0] is -10 in the design and -11 in the plant"),
        ('"position_b [m]"]', '"position_c [m]"]', "signals.y.names[1] is 'position_b' in the design and 'position_c'"),
        (
            "position_a = 1e-3, position_b",
            "position_a = 2e-3, position_b",
            "noise.sd[0] is 0.001 in the design and 0.002",
        ),
        ("size   = 0.01", "size   = 0.02", "faults[0].size is 0.01 in the design and 0.02 in the plant"),
    ],
)
def test_a_design_of_another_plant_says_what_differs(design, tmp_path, old, new, difference):
    write_design(design, tmp_path / "d.json")
    text = TEMPLATE.replace(old, new)
    if "position_c" in new:
        text = text.replace("position_b =", "position_c =").replace('sensor = "position_b"', 'sensor = "position_c"')
    message = refused(tmp_path / "d.json", parse_plant(text, "other.toml"))
    assert difference in message and "make the design again" in message


def test_a_design_of_a_larger_plant_says_so_without_printing_it(design, tmp_path):
    write_design(design, tmp_path / "d.json")
    message = refused(tmp_path / "d.json", fr.library("airliner"))
    assert "signals.u.names has 1 entries in the design and 4 in the plant" in message and len(message) < 400


def test_a_design_for_some_of_the_faults_belongs_to_the_plant_that_declares_them_all(tmp_path):
    more = parse_plant(TEMPLATE + '[[fault]]\nname = "second"\nsensor = "position_a"\n', "two.toml")
    write_design(fr.design(more, faults=["position_b_drift"]), tmp_path / "d.json")
    assert [f.name for f in read_design(tmp_path / "d.json", more).plant.faults] == ["position_b_drift"]


# ---------------------------------------------------------------- damage


@pytest.mark.parametrize("part", [0.0, 1e-4, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_design_file_is_refused(design, tmp_path, part):
    write_design(design, tmp_path / "d.json")
    whole = (tmp_path / "d.json").read_bytes()
    (tmp_path / "d.json").write_bytes(whole[: int(part * len(whole))])
    assert "is no design file" in refused(tmp_path / "d.json")


@pytest.mark.parametrize(
    "text", ["{}", "[]", "null", "NaN", '"x"', '{"kind": "faultrecon-design"}', "[" * 100_000, "\xff"]
)
def test_json_that_is_no_design_is_refused(tmp_path, text):
    path = tmp_path / "d.json"
    path.write_bytes(text.encode("latin-1"))
    refused(path)


def test_a_newer_file_is_refused_with_what_to_do(stored):
    assert "schema 2" in (message := refused(stored(lambda d: d.update(schema=2)))) and "update faultrecon" in message
    assert "schema 2" in refused(stored(lambda d: d["certificate"].update(schema=2)))


@pytest.mark.parametrize("key", ["plant", "gains", "details", "method", "optimum", "floor", "certificate"])
def test_a_missing_part_is_named(stored, key):
    assert key in refused(stored(lambda d: d.pop(key)))


@pytest.mark.parametrize("value", ["0.1", True, [1.0], {}, float("inf"), float("nan")])
def test_levels_in_a_file_are_numbers(stored, value):
    assert "optimum is" in refused(stored(lambda d: d.update(optimum=value)))


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in a document."""
    yield path
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in pairs:
        yield from places(inner, (*path, key))


def test_no_damage_to_a_design_file_ends_in_anything_but_a_message(document, tmp_path):
    rng, path = random.Random(1), tmp_path / "d.json"
    junk = [None, True, -1, 1e308, "", "nan", "0x1p3", [], {}, [[]], float("inf"), 10**30, {"shape": [1], "hex": []}]
    short = [p for p in places(document) if 0 < len(p) <= 3]
    long = [p for p in places(document) if len(p) > 3]
    for where in (*short, *rng.sample(long, 80)):
        changed = copy.deepcopy(document)
        inner = changed
        *outer, last = where
        for key in outer:
            inner = inner[key]
        inner[last] = rng.choice(junk)
        path.write_text(json.dumps(changed), encoding="utf-8")
        for read in (read_design, fr.load, lambda p: load_certificate(str(p)).verify()):
            try:
                read(path)
            except fr.InputError:
                continue


# ---------------------------------------------------------------- gains and statements that were changed


def turn_around(document):
    flat = document["gains"]["L"]["hex"]
    document["gains"]["L"]["hex"] = [(-float.fromhex(v)).hex() for v in flat]


def ask_for_less(document):
    document["certificate"]["level"] = (0.5 * float.fromhex(document["certificate"]["level"])).hex()


def leave_out(document):
    document["certificate"]["steps"] = [s for s in document["certificate"]["steps"] if s["label"] != "(3.1)"]


def claim_more(document):
    document["certificate"]["claim"] = "it is always right"


@pytest.mark.parametrize(
    ("change", "message"),
    [(turn_around, "gains or γ changed"), (ask_for_less, "gains or γ changed"), (leave_out, "statement changed")],
)
def test_a_change_after_the_proof_is_noticed(stored, change, message):
    path = stored(change)
    assert fr.verify(str(path)).verdict == "refuted" and message in str(fr.verify(str(path)))
    assert "refuted" in (told := refused(path)) or "does not state the theorem" in told


@pytest.mark.parametrize("change", [turn_around, ask_for_less])
def test_wrong_numbers_under_a_fresh_seal_fail_the_proof(stored, change):
    path = stored(lambda d: (change(d), sealed(d)))
    steps = {s.label: s.verdict for s in fr.verify(str(path)).steps}
    assert steps["identity"] == "proved" and steps["(3.1)"] == "refuted"
    assert "the certificate is refuted" in refused(path)


@pytest.mark.parametrize("change", [leave_out, claim_more])
def test_a_weaker_or_grander_statement_under_a_fresh_seal_is_not_the_theorem(stored, change):
    path = stored(lambda d: (change(d), sealed(d)))
    assert "does not state the theorem of lipschitz-hinf" in refused(path)


# ---------------------------------------------------------------- writing


def test_a_refuted_design_is_not_written(design, document, tmp_path):
    changed = copy.deepcopy(document)
    turn_around(changed)
    sealed(changed)
    broken = dataclasses.replace(design, certificate=Certificate.from_document(changed))
    with pytest.raises(fr.InputError, match=r"not certified: refuted +\(3\.1\)"):
        fr.save(broken, tmp_path / "d.json")
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_takes_no_design_is_refused_by_name(design, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.json").mkdir()
    for place in ("file/d.json", "missing/d.json", "folder.json", "d.toml", "d"):
        with pytest.raises(fr.InputError, match=re.escape(str(tmp_path / place))):
            fr.save(design, tmp_path / place)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.json"]


def test_a_name_that_no_file_system_takes_is_refused(design, tmp_path):
    with pytest.raises(fr.InputError, match=r"cannot write .*ddd\.json: "):
        fr.save(design, tmp_path / f"{'d' * 300}.json")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_permission_is_refused(design, tmp_path, monkeypatch):
    opened = os.open

    def deny(path, *rest, **more):  # the rights of a real folder do not bind an administrator
        if str(path).startswith(str(tmp_path)):
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, *rest, **more)

    monkeypatch.setattr(os, "open", deny)
    with pytest.raises(fr.InputError, match=r"cannot write .*d\.json: Permission denied"):
        fr.save(design, tmp_path / "d.json")


def test_a_disk_that_fills_up_leaves_the_old_file_and_nothing_else(design, tmp_path, monkeypatch):
    path = tmp_path / "d.json"
    fr.save(design, path)
    before = path.read_bytes()

    def half(self, text, **kwargs):
        with open(self, "w", encoding="utf-8") as file:
            file.write(text[: len(text) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pathlib.Path, "write_text", half)
    with pytest.raises(fr.InputError, match=r"cannot write .*d\.json: No space left on device"):
        fr.save(design, path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


WRITER = """
import sys
from pathlib import Path
from faultrecon.storage.atomic import write_text
texts = [Path(name).read_text(encoding="utf-8") for name in sys.argv[2:]]
print("ready", flush=True)
while True:
    for text in texts:
        write_text(sys.argv[1], text)
"""


def test_a_process_killed_while_writing_leaves_a_whole_file_or_none(design, tmp_path):
    sources = [tmp_path / "a.json", tmp_path / "b.json"]
    target = tmp_path / "out" / "d.json"
    target.parent.mkdir()
    for source, pad in zip(sources, ("", "\n" * 500_000), strict=True):  # long enough to be caught half-way
        source.write_text(json.dumps(design_document(design)) + pad, encoding="utf-8")
    whole = {source.read_bytes() for source in sources}
    rng = random.Random(0)
    for _ in range(6):
        command = [sys.executable, "-c", WRITER, str(target), *map(str, sources)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
            assert writer.stdout is not None and writer.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.03))
            writer.kill()
        assert not target.exists() or target.read_bytes() in whole
        assert {name for name in os.listdir(target.parent) if not name.startswith(".")} <= {"d.json"}
    assert target.exists() and isinstance(fr.load(target), fr.Design)
