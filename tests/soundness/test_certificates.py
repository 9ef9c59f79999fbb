# SPDX-License-Identifier: BSD-3-Clause
"""A certificate that is false is never called proved: every number and every word of it is spoilt in turn."""

import copy
import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given as forall
from hypothesis import settings
from hypothesis import strategies as st

from faultrecon.certificate import STRENGTH, Certificate, Step
from faultrecon.finding import Impossible, Inconclusive, InputError
from faultrecon.graph.function import Graph
from faultrecon.io.designfile import design_document, read_design, write_design
from faultrecon.io.library import read_library
from faultrecon.lmi.prove import fast_algebra
from faultrecon.methods.registry import method
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.lipschitz import KnownTerm
from faultrecon.synthesis import ladder
from faultrecon.synthesis.certify import conforms
from faultrecon.synthesis.levels import scale
from faultrecon.synthesis.pipeline import design

EPS = np.finfo(float).eps
POLYNOMIAL = design(read_library("lipschitz_polynomial"))
AIRCRAFT = design(read_library("lipschitz_aircraft"))
DESIGNS = {"polynomial": POLYNOMIAL, "aircraft": AIRCRAFT}


def document(found):
    """A design as its file holds it, free to be spoilt."""
    return json.loads(json.dumps(design_document(found)))


def read(stored, reseal):
    """The certificate of a document, with its own digests or with digests that fit what it says now."""
    made = Certificate.from_document(stored)
    return made.sealed() if reseal else made


def theorem_of(found):
    return method(found.method).theorem(found.plant, scale(found.plant))


# ---------------------------------------------------------------- an independent reading, in rational numbers


def matrix(stored):
    rows, columns = stored["shape"]
    values = [Fraction(float.fromhex(v)) for v in stored["hex"]]
    return [values[i * columns : (i + 1) * columns] for i in range(rows)], (rows, columns)


def letters(stored):
    """Every letter of a document: matrix and shape."""
    certificate = stored["certificate"]
    found = {f"plant.{k}": matrix(v) for k, v in stored["plant"]["matrices"].items()}
    found |= {k: matrix(v) for k, v in {**stored["gains"], **certificate["data"]}.items()}
    found["γ"] = [[Fraction(float.fromhex(certificate["level"]))]], (1, 1)
    for name, tree in certificate["lets"].items():
        found[name] = value(tree, found)
    return found


def value(tree, known):
    """A stored tree in rational numbers: matrix and shape, by code that shares nothing with the checker."""
    if isinstance(tree, str):
        return known[tree]
    op, *arguments = tree
    if op == "number":
        return [[Fraction(float.fromhex(arguments[0]))]], (1, 1)
    if op == "eye":
        n = arguments[0]
        return [[Fraction(i == j) for j in range(n)] for i in range(n)], (n, n)
    if op == "zero":
        r, c = arguments
        return [[Fraction(0)] * c for _ in range(r)], (r, c)
    if op == "block":
        rows = [[value(b, known) for b in row] for row in arguments[0]]
        out = [[v for b in row for v in b[0][i]] for row in rows for i in range(row[0][1][0])]
        return out, (len(out), sum(b[1][1] for b in rows[0]))
    parts = [value(a, known) for a in arguments]
    (a, (r, c)) = parts[0]
    if op == "neg":
        return [[-v for v in row] for row in a], (r, c)
    if op == "T":
        return [[a[i][j] for i in range(r)] for j in range(c)], (c, r)
    (b, (s, d)) = parts[1]
    if op == "add":
        return [[x + y for x, y in zip(p, q, strict=True)] for p, q in zip(a, b, strict=True)], (r, c)
    if op == "scale":
        return [[a[0][0] * v for v in row] for row in b], (s, d)
    assert op == "matmul"
    out = [[sum((a[i][k] * b[k][j] for k in range(c)), Fraction(0)) for j in range(d)] for i in range(r)]
    return out, (r, d)


def holds(stored):
    """Whether every claim of a document is true, by rational elimination."""
    known = letters(stored)
    for step in stored["certificate"]["steps"]:
        if step["kind"] == "positive":
            rows, (n, _) = value(step["tree"], known)
            if any(rows[i][j] != rows[j][i] for i in range(n) for j in range(i)):
                return False
            for k in range(n):
                if rows[k][k] <= 0:
                    return False
                for i in range(k + 1, n):
                    factor = rows[i][k] / rows[k][k]
                    if factor:
                        rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
        elif step["kind"] == "zero":
            rows, _ = value(step["tree"], known)
            if any(abs(v) > Fraction(float.fromhex(step["tolerance"])) for row in rows for v in row):
                return False
    return True


# ---------------------------------------------------------------- numbers


@pytest.mark.parametrize("name", DESIGNS)
def test_a_design_as_it_was_made_holds_by_either_arithmetic(name):
    stored = document(DESIGNS[name])
    assert holds(stored)
    for algebra in (None, fast_algebra()):
        found = read(stored, reseal=False).verify(algebra)
        assert found.sound
        assert all(step.verdict == "proved" for step in found.steps if step.label != "Lipschitz constant")
    assert conforms(read(stored, reseal=False), theorem_of(DESIGNS[name]))


@pytest.mark.parametrize("name", DESIGNS)
def test_a_certificate_with_an_assumed_premise_is_no_stronger_than_assumed(name):
    assert DESIGNS[name].verification.verdict == "assumed"


PLACES = [
    ("gains", "L"),
    ("gains", "K1"),
    ("certificate", "data", "P"),
    ("certificate", "data", "β"),
    ("certificate", "data", "N"),
    ("certificate", "data", "F⁺"),
    ("certificate", "data", "T"),
    ("certificate", "data", "T⁻¹"),
    ("certificate", "data", "R"),
    ("certificate", "data", "R⁻¹"),
    *[("plant", "matrices", k) for k in ("A", "C", "E_w", "F_w", "F_f", "G", "H", "W", "V", "α")],
]


def spoil(stored, place, k, change):
    """Change one number of a document."""
    part = stored
    for key in place:
        part = part[key]
    k %= len(part["hex"])
    part["hex"][k] = change(float.fromhex(part["hex"][k])).hex()


CHANGES = [
    lambda v: -v,
    lambda v: v * 0.0,
    lambda v: v * 1e3 + 1.0,
    lambda v: v * 1.5,
    lambda v: v * (1 + 1e-3) + 1e-3,
    lambda v: v * (1 + EPS) if v else 5e-324,
    lambda v: v - 10.0,
]


@settings(max_examples=150, deadline=None)
@forall(
    st.sampled_from(sorted(DESIGNS)),
    st.sampled_from(PLACES),
    st.integers(0, 1000),
    st.sampled_from(range(len(CHANGES))),
    st.booleans(),
)
def test_no_changed_number_makes_a_false_statement_proved(name, place, k, change, reseal):
    stored = document(DESIGNS[name])
    spoil(stored, place, k, CHANGES[change])
    found = read(stored, reseal).verify(fast_algebra())
    if not holds(stored):
        assert found.verdict == "refuted"
    elif reseal:
        assert found.sound  # a true statement is proved: exact arithmetic decides every case


@pytest.mark.parametrize("name", DESIGNS)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 0.99])
def test_a_level_below_the_optimum_is_never_proved(name, share):
    stored = document(DESIGNS[name])
    stored["certificate"]["level"] = (share * DESIGNS[name].optimum).hex()
    assert not holds(stored)
    assert read(stored, reseal=True).verify().verdict == "refuted"
    assert read(stored, reseal=False).verify().verdict == "refuted"


@pytest.mark.parametrize("level", [float("nan"), float("inf"), -float("inf")])
def test_a_level_that_is_no_number_is_refuted(level):
    stored = document(POLYNOMIAL)
    stored["certificate"]["level"] = level.hex()
    assert read(stored, reseal=True).verify().verdict == "refuted"


def test_the_level_at_which_the_inequality_turns_is_found_to_the_last_bit():
    stored = document(POLYNOMIAL)
    low, high = POLYNOMIAL.optimum, POLYNOMIAL.level
    while low < (middle := 0.5 * (low + high)) < high:
        stored["certificate"]["level"] = middle.hex()
        low, high = (low, middle) if read(stored, reseal=True).verify(fast_algebra()).sound else (middle, high)
    for level, true in ((low, False), (high, True)):
        stored["certificate"]["level"] = level.hex()
        assert holds(stored) is true
        assert read(stored, reseal=True).verify().sound is true
    assert np.nextafter(low, np.inf) == high


@pytest.mark.parametrize("name", DESIGNS)
def test_any_changed_number_of_plant_gains_or_level_breaks_a_digest(name):
    for place in [p for p in PLACES if p[0] in ("plant", "gains")]:
        if not DESIGNS[name].plant.letters().get(place[-1], np.ones(1)).size:
            continue
        stored = document(DESIGNS[name])
        spoil(stored, place, 0, lambda v: v + 1.0)
        assert read(stored, reseal=False).verify(fast_algebra()).steps[0].verdict == "refuted"


# ---------------------------------------------------------------- words


def step_of(stored, label):
    return next(s for s in stored["certificate"]["steps"] if s["label"] == label)


def weaker_statements():
    """Documents that prove less than the theorem, each by another trick; digests are made to fit afterwards."""

    def trivial(d):
        step_of(d, "(3.1)")["tree"] = ["eye", 2]

    def empty(d):
        step_of(d, "(3.1)")["tree"] = ["block", []]

    def as_zero(d):
        step_of(d, "(3.1)").update(kind="zero", tolerance=(1e300).hex())

    def as_premise(d):
        step_of(d, "(3.1)").update(kind="premise", text="proved elsewhere", verdict="proved")

    def dropped(d):
        d["certificate"]["steps"] = [s for s in d["certificate"]["steps"] if s["label"] != "(3.1)"]

    def identity_dropped(d):
        d["certificate"]["steps"] = [s for s in d["certificate"]["steps"] if s["label"] != "T T⁻¹ = I"]

    def tolerance(d):
        step_of(d, "N F = 0: healthy outputs carry no fault")["tolerance"] = (1.0).hex()

    def twice(d):
        false, true = copy.deepcopy(step_of(d, "(3.1)")), step_of(d, "(3.1)")
        false["tree"] = ["eye", 2]
        d["certificate"]["steps"].insert(d["certificate"]["steps"].index(true), false)

    def other_definition(d):
        d["certificate"]["lets"]["Ω"] = ["neg", ["eye", 2]]

    def extra_definition(d):
        d["certificate"]["lets"]["unused"] = ["eye", 1]

    def upgraded(d):
        step_of(d, "Lipschitz constant")["verdict"] = "proved"

    def no_premise(d):
        d["certificate"]["steps"] = [s for s in d["certificate"]["steps"] if s["kind"] != "premise"]

    def claim(d):
        d["certificate"]["claim"] = "the error is zero"

    def scope(d):
        d["certificate"]["scope"] = "covers everything"

    def smaller_plant(d):
        d["plant"]["matrices"]["α"]["hex"] = [(0.0).hex()]

    def no_healthy_output(d):
        d["certificate"]["data"]["N"]["hex"] = [(0.0).hex()] * len(d["certificate"]["data"]["N"]["hex"])
        d["gains"]["L"]["hex"] = [(-1e6).hex()] * 2

    def negative_level(d):
        d["certificate"]["level"] = (-float.fromhex(d["certificate"]["level"])).hex()

    return {
        f.__name__: f
        for f in (
            *(trivial, empty, as_zero, as_premise, dropped, identity_dropped, tolerance, twice, other_definition),
            *(extra_definition, upgraded, no_premise, claim, scope, smaller_plant, no_healthy_output, negative_level),
        )
    }


@pytest.mark.parametrize("trick", weaker_statements())
def test_a_statement_other_than_the_theorem_does_not_conform(trick):
    stored = document(POLYNOMIAL)
    weaker_statements()[trick](stored)
    assert not conforms(read(stored, reseal=True), theorem_of(POLYNOMIAL))


@pytest.mark.parametrize("trick", weaker_statements())
def test_a_design_file_with_a_weaker_statement_is_refused(trick, tmp_path):
    stored = document(POLYNOMIAL)
    weaker_statements()[trick](stored)
    stored["certificate"]["digests"] = dict(read(stored, reseal=True).digests)
    path = tmp_path / "design.json"
    path.write_text(json.dumps(stored), encoding="utf-8")
    with pytest.raises(InputError, match=r"theorem|contradicts|refuted"):
        read_design(path)


def test_a_certificate_of_another_plant_does_not_conform():
    other = replace(POLYNOMIAL.plant, nonlinearity=replace(POLYNOMIAL.plant.nonlinearity, constant=1.2))
    theorem = method("lipschitz-hinf").theorem(other, scale(other))
    assert not conforms(POLYNOMIAL.certificate, theorem)


def test_a_healthy_direction_that_is_not_the_observers_own_does_not_conform():
    # The observer derives N again from F; a certificate about another N would be about another observer.
    plant = read_library("lipschitz_aircraft")
    found = design(replace(plant, faults=(FaultChannel("f", {"y3": 0.1, "y4": 0.3}),)))
    stored = document(found)
    hexes = stored["certificate"]["data"]["N"]["hex"]
    columns = stored["certificate"]["data"]["N"]["shape"][1]
    stored["certificate"]["data"]["N"]["hex"] = hexes[columns:] + hexes[:columns]
    assert not conforms(read(stored, reseal=True), theorem_of(found))


def test_a_definition_cannot_replace_a_number():
    for name in ("P", "L", "γ", "plant.A"):
        stored = document(POLYNOMIAL)
        stored["certificate"]["lets"] = {name: ["eye", 2], **stored["certificate"]["lets"]}
        found = read(stored, reseal=True).verify()
        assert found.verdict == "refuted"
        assert "defined twice" in found.steps[-1].how


def test_a_number_cannot_be_stored_twice():
    stored = document(POLYNOMIAL)
    stored["certificate"]["data"]["L"] = stored["gains"]["L"]
    assert read(stored, reseal=True).verify().verdict == "refuted"
    stored = document(POLYNOMIAL)
    stored["certificate"]["data"]["γ"] = {"shape": [1, 1], "hex": [(100.0).hex()]}
    assert read(stored, reseal=True).verify().verdict == "refuted"


def test_a_certificate_without_an_inequality_is_refuted():
    stored = document(POLYNOMIAL)
    for steps in ([], [s for s in stored["certificate"]["steps"] if s["kind"] != "positive"]):
        made = read({**stored, "certificate": {**stored["certificate"], "steps": steps}}, reseal=True)
        assert made.verify().verdict == "refuted"


def test_an_asymmetric_multiplier_is_refuted():
    stored = document(POLYNOMIAL)
    spoil(stored, ("certificate", "data", "P"), 1, lambda v: v * (1 + EPS))
    assert read(stored, reseal=True).verify().verdict == "refuted"


def test_a_whole_certificate_is_as_strong_as_its_weakest_step():
    made = POLYNOMIAL.certificate
    base = tuple(s for s in made.steps if s.kind != "premise")
    for verdict in ("assumed", "checked", "proved"):
        steps = (*base, Step("a premise", "premise", text="said so", verdict=verdict))
        found = Certificate(**{**made.__dict__, "steps": steps}).sealed().verify(fast_algebra())
        assert found.verdict == verdict
    assert sorted(STRENGTH, key=STRENGTH.__getitem__) == ["refuted", "assumed", "checked", "proved"]


@pytest.mark.parametrize("verdict", ["refuted", "certain", ""])
def test_a_stored_premise_has_one_of_three_verdicts(verdict):
    stored = document(POLYNOMIAL)
    step_of(stored, "Lipschitz constant")["verdict"] = verdict
    with pytest.raises(InputError, match="damaged"):
        read(stored, reseal=False)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 10**9) | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=200, deadline=None)
@forall(st.data(), JUNK)
def test_damage_anywhere_is_refused_or_refuted_and_never_a_crash(data, junk):
    stored = document(POLYNOMIAL)
    part = {k: stored[k] for k in ("plant", "gains", "certificate")}
    stored = part
    for _ in range(data.draw(st.integers(1, 6))):
        keys = list(part) if isinstance(part, dict) else list(range(len(part))) if isinstance(part, list) else []
        if not keys:
            break
        key = data.draw(st.sampled_from(keys))
        last, part = part, part[key]
    changed = last[key] != junk
    last[key] = junk
    try:
        made = Certificate.from_document(stored)
    except InputError:
        return
    found = made.verify(fast_algebra())
    words = {"claim", "scope", "method"}  # these are not digested; `conforms` compares them
    if changed and key not in words and "data" not in stored["certificate"]:
        assert found.verdict == "refuted"


def nested(depth):
    tree = "P"
    for _ in range(depth):
        tree = ["neg", tree]
    return tree


@pytest.mark.parametrize(
    "tree",
    [
        *(["eye", 10**9], ["zero", 10**9, 10**9], ["block", [[]]], ["block", ["P"]], ["block", 3], ["number", "x"]),
        *(["number", "nan"], ["exec", "P"], ["add", "P"], {"neg": "P"}, None, 7, ["T"], nested(5000), ["inv", "P"]),
    ],
)
@pytest.mark.parametrize("place", ["step", "let"])
def test_a_tree_that_cannot_be_read_is_refuted(tree, place):
    made = POLYNOMIAL.certificate
    if place == "step":
        steps = (*made.steps, Step("odd", "positive", tree))
        made = Certificate(**{**made.__dict__, "steps": steps})
    else:
        made = Certificate(**{**made.__dict__, "lets": {**made.lets, "odd": tree}})
    assert made.verify(fast_algebra()).verdict == "refuted"


# ---------------------------------------------------------------- no proof, no design


@pytest.mark.parametrize("options", [{}, {"level": 4.0}])
def test_a_design_whose_proof_fails_is_never_returned(monkeypatch, options):
    real = ladder.prove

    def refutes(made):
        return real(Certificate(**{**made.__dict__, "level": 0.0}).sealed())

    monkeypatch.setattr(ladder, "prove", refutes)
    with pytest.raises(Inconclusive, match="could be proved"):
        design(read_library("lipschitz_polynomial"), **options)


@pytest.mark.parametrize("spoilt", [lambda v: -v, lambda v: v * 0, lambda v: v - 1e6])
def test_rounding_that_spoils_the_gains_gives_no_design(monkeypatch, spoilt):
    real = ladder.shipped
    monkeypatch.setattr(ladder, "shipped", lambda *a: {k: spoilt(v) if k == "L" else v for k, v in real(*a).items()})
    with pytest.raises(Inconclusive, match="could be proved"):
        design(read_library("lipschitz_polynomial"))


def test_a_solver_that_lies_about_its_point_gives_no_design(monkeypatch):
    real = ladder.smallest_gain

    def lies(posed, level):
        outcome = real(posed, level)
        return replace(outcome, values={**outcome.values, "Z": -outcome.values["Z"]})

    monkeypatch.setattr(ladder, "smallest_gain", lies)
    with pytest.raises(Inconclusive, match="could be proved"):
        design(read_library("lipschitz_polynomial"))


def test_a_refuted_design_is_not_written(tmp_path):
    spoilt = replace(POLYNOMIAL, certificate=Certificate(**{**POLYNOMIAL.certificate.__dict__, "level": 1.0}).sealed())
    path = tmp_path / "design.json"
    with pytest.raises(InputError, match="not certified"):
        write_design(spoilt, path)
    assert list(tmp_path.iterdir()) == []


def test_a_design_survives_its_file(tmp_path):
    path = tmp_path / "design.json"
    write_design(AIRCRAFT, path)
    back = read_design(path)
    assert back.verification.verdict == AIRCRAFT.verification.verdict
    assert back.plant.digest() == AIRCRAFT.plant.digest()
    assert all(np.array_equal(back.gains[k], AIRCRAFT.gains[k]) for k in AIRCRAFT.gains)


# ---------------------------------------------------------------- what a claim is about


def test_a_fault_on_several_sensors_is_certified_with_identities_to_rounding():
    plant = read_library("lipschitz_aircraft")
    mixed = replace(plant, faults=(FaultChannel("f", {"y3": 0.1, "y4": 0.3}),))
    found = design(mixed)
    stored = document(found)
    assert holds(stored)
    N, Fp = (np.array(matrix(stored["certificate"]["data"][k])[0], dtype=float) for k in ("N", "F⁺"))
    # An orthonormal annihilator rounds by a few eps; the identities allow 2**-40.
    assert np.abs(N @ mixed.F_f).max() <= 2.0**-40
    assert np.abs(Fp @ mixed.F_f - 1.0).max() <= 2.0**-40


@pytest.mark.parametrize("name", ["lipschitz-hinf", "open-loop"])
@pytest.mark.parametrize("traced", [False, True])
def test_a_known_term_that_reads_a_faulty_sensor_is_refused_however_it_was_written(name, traced):
    plant = read_library("lipschitz_aircraft")
    if traced:
        g = Graph.trace(lambda y, u, t: [0.1 * y[2]], {"y": 4, "u": 1, "t": 1})  # y[2] is the sensor y3
    else:
        g = Graph.from_texts(["0.1*y3"], {"y": plant.signals.y.names, "u": ("u",), "t": ("t",)})
    with pytest.raises(Impossible, match="g reads y3, which may be faulty"):
        design(replace(plant, known=KnownTerm(np.eye(6)[:, :1], g)), name)


@pytest.mark.parametrize("name", ["lipschitz-hinf", "open-loop"])
@pytest.mark.parametrize("change", ["sampled", "multiplicative", "actuator"])
def test_a_plant_outside_the_theorems_scope_is_refused_not_certified(name, change):
    plant = read_library("lipschitz_aircraft")
    match change:
        case "sampled":
            plant = replace(plant, sample_time=0.01)
        case "multiplicative":
            plant = replace(plant, faults=(FaultChannel("f", {"y3": 1.0}, effect="multiplicative"),))
        case "actuator":
            plant = replace(plant, faults=(FaultChannel("f", {"u": 1.0}, site="actuator"),))
    with pytest.raises(Impossible):
        design(plant, name)
