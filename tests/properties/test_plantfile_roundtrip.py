# SPDX-License-Identifier: BSD-3-Clause
import keyword
import tomllib
from itertools import chain

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.io.plantfile import parse_plant
from faultrecon.io.plantwrite import plant_text
from faultrecon.io.positions import positions
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import KnownTerm, Lipschitz
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals

# Products of two entries must not overflow: B times the coefficient of an actuator fault.
numbers = st.floats(-1e150, 1e150) | st.sampled_from([0.0, -0.0, 1.0, -1.0, 5e-324, 0.1])
positive = st.floats(1e-300, 1e300)
signal_names = st.from_regex(r"[A-Za-z_][A-Za-z_0-9]{0,6}", fullmatch=True).filter(
    lambda name: name not in ("t", "time") and not keyword.iskeyword(name)
)
# Any text a person can type, control characters included; surrogates are no text.
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
titles = words.filter(lambda name: name.strip() and name.isprintable())
units = words.filter(lambda text: not set(text) & set("[]"))


@st.composite
def channels(draw, names):
    ranges = draw(st.lists(positive | st.just(float("nan")), min_size=len(names), max_size=len(names)))
    return Channels(tuple(names), tuple(draw(units) for _ in names), tuple(ranges))


def matrix(rows, columns):
    row = st.lists(numbers, min_size=columns, max_size=columns)
    return st.lists(row, min_size=rows, max_size=rows).map(lambda v: np.array(v, dtype=float).reshape(rows, columns))


def coefficients(names, least=0):
    if not names:
        return st.just({})
    return st.dictionaries(st.sampled_from(names), numbers, min_size=least)


@st.composite
def formulas(draw, names, constants):
    """A formula in the given names, built as people write them."""
    atoms = st.sampled_from([*names, *constants, "1.5", "2e-3"])
    shapes = [
        "{a}",
        "-{a}*{b}",
        "sin({a}) + {b}",
        "abs({a} - 0.25)",
        " {a}\t* {a}**2 / 3",
        "min({a},\n{b})",
        "sat({a})",
    ]
    return draw(st.sampled_from(shapes)).format(a=draw(atoms), b=draw(atoms))


@st.composite
def constants(draw, taken):
    return draw(st.dictionaries(signal_names.filter(lambda n: n not in taken), st.floats(-1e9, 1e9), max_size=2))


@st.composite
def nonlinearities(draw, x, u):
    reads = tuple(draw(st.lists(st.sampled_from(x), unique=True)))
    width = draw(st.integers(1, 2))
    known = draw(constants([*x, *u]))
    texts = [draw(formulas([*reads, *u, "t"], list(known))) for _ in range(width)]
    phi = Graph.from_texts(texts, {"x": reads, "u": u, "t": ("t",)}, known)
    ends = st.tuples(st.floats(-1e9, 0.0), st.floats(1e-3, 1e9) | st.just(float("inf")))
    domain = draw(st.dictionaries(st.sampled_from(reads), ends)) if reads else {}
    return Lipschitz(draw(matrix(len(x), width)), reads, phi, draw(st.floats(0.0, 1e300)), "assumed", domain)


@st.composite
def known_terms(draw, x, u, y):
    known = draw(constants([*y, *u]))
    g = Graph.from_texts([draw(formulas([*y, *u, "t"], list(known)))], {"y": y, "u": u, "t": ("t",)}, known)
    return KnownTerm(draw(matrix(len(x), 1)), g)


@st.composite
def faults(draw, name, y, u):
    site = draw(st.sampled_from(["sensor", "actuator"])) if u else "sensor"
    on = draw(coefficients(u if site == "actuator" else y, least=1).filter(lambda table: any(table.values())))
    effect = draw(st.sampled_from(["additive", "multiplicative"]))
    return FaultChannel(name, on, site, effect, draw(positive), draw(positive | st.just(float("inf"))))


@st.composite
def disturbances(draw, name, x, y):
    role = draw(st.sampled_from(["attenuate", "decouple", "noise"]))
    return Disturbance(name, draw(coefficients(x)), draw(coefficients(y)), role, draw(positive))


@st.composite
def plants(draw):
    """Any plant a file can hold: every optional part present or absent, states and sensors sharing names or not."""
    pool = draw(st.lists(signal_names, min_size=7, max_size=7, unique=True))
    x, u = tuple(pool[: draw(st.integers(1, 3))]), tuple(pool[3 : 3 + draw(st.integers(0, 2))])
    y = tuple(draw(st.lists(st.sampled_from([*x, *pool[5:]]), min_size=1, unique=True)))
    n, m, p = len(x), len(u), len(y)
    q, k = draw(st.integers(0, 2)), draw(st.integers(0, 2))
    names = draw(st.lists(titles, min_size=q + k, max_size=q + k, unique=True))
    point = [tuple(draw(st.lists(numbers, min_size=size, max_size=size))) for size in (n, m, p)]
    levels = tuple(draw(st.lists(st.floats(0.0, 1e300), min_size=p, max_size=p)))
    picked = st.lists(st.sampled_from(range(n)), min_size=p, max_size=p).map(lambda rows: np.eye(n)[rows])
    return Plant(
        name=draw(words),
        signals=Signals(draw(channels(x)), draw(channels(u)), draw(channels(y))),
        A=draw(matrix(n, n)),
        B=draw(matrix(n, m)),
        C=draw(matrix(p, n) | picked),
        D=draw(matrix(p, m) | st.just(np.zeros((p, m)))),
        faults=tuple(draw(faults(name, y, u)) for name in names[:q]),
        disturbances=tuple(draw(disturbances(name, x, y)) for name in names[q:]),
        nonlinearity=draw(st.none() | nonlinearities(x, u)),
        known=draw(st.none() | known_terms(x, u, y)),
        noise=draw(st.none() | st.builds(Noise, positive, st.just(levels))),
        operating_point=draw(st.sampled_from([None, OperatingPoint(*point)])),
        sample_time=draw(st.none() | positive),
        source=draw(words),
    )


@settings(max_examples=80, deadline=None)
@given(plants())
def test_any_plant_reads_back_the_same_to_the_last_bit(plant):
    again = parse_plant(plant_text(plant))
    assert again.digest() == plant.digest() and again.source == plant.source


@settings(max_examples=40, deadline=None)
@given(plants())
def test_every_value_of_a_written_file_has_a_line_of_its_own(plant):
    text = plant_text(plant)
    lines = positions(text)

    def paths(value, path=()):
        children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        return [path, *chain.from_iterable(paths(inner, (*path, key)) for key, inner in children)]

    assert set(paths(tomllib.loads(text))[1:]) == set(lines)
    assert sorted(lines.values())[-1] <= text.count("\n")


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_damaged_file_gives_a_plant_or_a_refusal_with_file_and_line(data):
    text = EXAMPLE
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        stop = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.text("[]{}=\"',.#\n 0-ename_", max_size=4)) + text[stop:]
    try:
        parse_plant(text, "damaged.toml")
    except InputError as error:
        place, _, _ = str(error).partition("  ")
        name, _, line = place.partition(":")
        assert name == "damaged.toml" and 1 <= int(line) <= text.count("\n") + 1


EXAMPLE = """\
schema = 1
name = "damaged"
[signals]
x = ["a [m]", "b"]
u = ["v"]
y = ["c", "d"]
range = { a = 1.0, c = 2.0 }
[noise]
hold = 0.1
sd = { c = 0.1, d = 0.2 }
[matrices]
A = [[0, 1], [-1.5, -2]]
B = [[0], [1]]
C = { select = ["a", "b"] }
[nonlinearity]
into = [{ b = 1.0 }]
phi = ["k * sin(a)"]
constants = { k = 0.5 }
domain = { a = [-1, 1] }
lipschitz = 1.0
[known]
into = ["b"]
g = ["v * c"]
[[disturbance]]
name = "w"
into = { a = 1.0 }
[[fault]]
name = "f"
sensor = "d"
"""
