# SPDX-License-Identifier: BSD-3-Clause
"""A design does not depend on units, on the order of names, or on sensors it does not need."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from faultrecon.diagnosis.existence import detectability_findings
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.finding import FaultreconError
from faultrecon.graph.function import Graph
from faultrecon.io.library import read_library
from faultrecon.lmi.expr import __, sym
from faultrecon.methods.lipschitz_hinf import LipschitzHinf
from faultrecon.methods.registry import offered
from faultrecon.numerics.hinf import frequency_response
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.synthesis.pipeline import design, optimum
from faultrecon.synthesis.report import fault_noise

LEVEL = 2e-5
"""Relative accuracy of an infimum that is not attained, as measured against the Riccati path (1e-5 in Example 4.1)."""


def robot(α=2.0, noisy=True):
    """A two-mass drive with a nonlinear spring, noise on each sensor, faults on the last two sensors; well scaled."""
    names = ("a", "va", "b", "vb")
    A = np.array([[0, 1, 0, 0], [-5, -1.2, 5, 0], [0, 0, 0, 1], [4, 0, -4, -0.8]], dtype=float)
    C = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
    phi = Graph.from_texts([f"{α!r}*sin(b)"], {"x": ["b"], "u": ["torque"], "t": ["t"]})
    into = np.array([[0.0], [0.0], [0.0], [0.2]])
    sensors = ("ya", "yb", "tacho_a", "tacho_b")
    return Plant(
        "drive",
        Signals(Channels(names), Channels(("torque",)), Channels(sensors)),
        A,
        np.array([[0.0], [1.0], [0.0], [0.0]]),
        C,
        np.zeros((4, 1)),
        faults=(FaultChannel("fa", {"tacho_a": 1.0}), FaultChannel("fb", {"tacho_b": 1.0})),
        disturbances=(
            Disturbance("load", {"vb": 1.0}),
            *(Disturbance(f"n{k}", {}, {s: 0.1}) for k, s in enumerate(sensors)),
        ),
        nonlinearity=Lipschitz(into, ("b",), phi, α),
        noise=Noise(0.01, (1e-3, 1e-3, 1e-2, 1e-2)) if noisy else None,
    )


def in_units(plant, units):
    """The same plant with state k measured in units[k]: x_old = units * x_new."""
    units = np.asarray(units, dtype=float)
    old, term = plant.signals.x.names, plant.nonlinearity
    if term is not None:
        (name,) = term.reads  # the constant is then moved by exactly that state's unit
        unit = float(units[old.index(name)])
        sizes = {"x": 1, "u": len(plant.signals.u), "t": 1}
        phi = Graph.trace(lambda x, u, t: term.phi.symbolic(x[0] * unit, u, t), sizes)
        term = replace(term, phi=replace(phi, inputs=dict(term.phi.inputs)), constant=term.constant * unit)
    return replace(
        plant,
        A=plant.A * units[None, :] / units[:, None],
        B=plant.B / units[:, None],
        C=plant.C * units[None, :],
        disturbances=tuple(
            replace(d, into={n: v / units[old.index(n)] for n, v in d.into.items()}) for d in plant.disturbances
        ),
        nonlinearity=None if term is None else replace(term, into=term.into / units[:, None]),
    )


def permuted(plant, states, sensors, faults):
    """The same plant with states, sensors and faults listed in another order."""
    states, sensors = list(states), list(sensors)
    x, y = (Channels(tuple(g.names[k] for k in o)) for g, o in ((plant.signals.x, states), (plant.signals.y, sensors)))
    term, noise = plant.nonlinearity, plant.noise
    return replace(
        plant,
        signals=Signals(x, plant.signals.u, y),
        A=plant.A[np.ix_(states, states)],
        B=plant.B[states],
        C=plant.C[np.ix_(sensors, states)],
        D=plant.D[sensors],
        faults=tuple(plant.faults[k] for k in faults),
        nonlinearity=None if term is None else replace(term, into=term.into[states]),
        noise=None if noise is None else Noise(noise.hold, tuple(noise.sd[k] for k in sensors)),
    )


def fault_response(found):
    """From (u, y) to each reconstructed fault at a few frequencies (linear part), faults and sensors by name."""
    o, plant = found.observer, found.plant
    names = [f.name for f in plant.faults]
    G = frequency_response(o.A, o.B, o.Cf, o.Df, np.array([0.0, 0.3, 1.0, 3.0, 30.0]))
    rows, columns = np.argsort(names), o.inputs + np.argsort(plant.signals.y.names)
    return G[:, rows][:, :, [*range(o.inputs), *columns]]


def same_reconstruction(one, other):
    """Whether two designs react alike.

    Gains are found by minimising a bound on the noise whose second derivative is of the order of the bound itself; the
    bound settles to the 1e-3 at which the majorisation stops, hence gains to its root, about 3e-2.
    """
    G, H = fault_response(one), fault_response(other)
    return np.abs(G - H).max() <= 3e-2 * np.abs(G).max()


REFERENCE = design(robot())


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(-6, 6), min_size=4, max_size=4))
@example([-6, 0, 5, -6])  # one route to the optimum claims a bound there that a point of the other refutes
def test_units_of_the_states_change_neither_level_nor_reconstruction(powers):
    found = design(in_units(robot(), 10.0 ** np.array(powers)))
    assert found.optimum == pytest.approx(REFERENCE.optimum, rel=LEVEL)
    assert found.level == pytest.approx(REFERENCE.level, rel=LEVEL)
    assert found.verification.sound
    assert same_reconstruction(REFERENCE, found)


@pytest.mark.parametrize("name", ["lipschitz_aircraft", "lipschitz_polynomial"])
def test_a_million_between_two_states_leaves_the_optima_of_the_examples(name):
    plant = replace(read_library(name), nonlinearity=None)
    units = 10.0 ** np.linspace(-3, 3, plant.n)
    expected = optimum(plant)
    assert optimum(in_units(plant, units)) == pytest.approx(expected, rel=LEVEL)
    assert optimum(in_units(plant, units[::-1])) == pytest.approx(expected, rel=LEVEL)


def test_powers_of_two_change_nothing_at_all_but_the_units():
    found = design(in_units(robot(), 2.0 ** np.array([3, -5, 10, 0])))
    assert found.optimum == pytest.approx(REFERENCE.optimum, rel=LEVEL)
    assert same_reconstruction(REFERENCE, found)


@settings(max_examples=6, deadline=None)
@given(st.permutations(range(4)), st.permutations(range(4)), st.permutations(range(2)))
def test_the_order_of_states_sensors_and_faults_changes_nothing(states, sensors, faults):
    found = design(permuted(robot(), states, sensors, faults))
    assert found.optimum == pytest.approx(REFERENCE.optimum, rel=LEVEL)
    assert found.floor == pytest.approx(REFERENCE.floor, rel=1e-8)  # bisection to 1e-9
    assert same_reconstruction(REFERENCE, found)


class Restated(LipschitzHinf):
    """Theorem 3.1 with its inequalities joined to block diagonals as `groups` says, and some of them stated twice."""

    name = "restated"

    def __init__(self, groups, twice):
        self.groups, self.twice = groups, twice

    def theorem(self, plant, scaling):
        """No filter form: the level is then found from these inequalities alone."""
        th = super().theorem(plant, scaling)
        stated = list(zip(th.inequalities, self.groups, strict=True))
        joined = [together([i for i, g in stated if g == group]) for group in sorted(set(self.groups))]
        again = [th.inequalities[k].tagged(f"{th.inequalities[k].label}, again") for k in sorted(self.twice)]
        return replace(th, inequalities=[*joined, *again], filter=None)


def together(inequalities):
    """One inequality on the block diagonal of the positive sides."""
    first, *others = inequalities
    for other in others:
        label = f"{first.label}, {other.label}"
        first = (sym([[first.positive, 0], [__, other.positive]]) > 0).tagged(label)
    return first


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 2), min_size=3, max_size=3), st.sets(st.integers(0, 2)))
def test_an_inequality_split_in_two_or_stated_twice_changes_nothing(groups, twice):
    with offered(Restated(groups, twice)):
        found = design(robot(), method="restated")
        assert found.optimum == pytest.approx(REFERENCE.optimum, rel=LEVEL)
        assert found.level == pytest.approx(REFERENCE.level, rel=LEVEL)
        assert found.certificate.claim == REFERENCE.certificate.claim
        assert found.verification.verdict == REFERENCE.verification.verdict
        assert same_reconstruction(REFERENCE, found)


@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1e3, 1e6])
def test_units_of_the_healthy_sensors_change_nothing(unit):
    plant = robot()
    scale = np.array([unit, 1.0, 1.0, 1.0])
    changed = replace(
        plant,
        C=plant.C * scale[:, None],
        disturbances=tuple(
            replace(d, on={k: v * (unit if k == "ya" else 1.0) for k, v in d.on.items()}) for d in plant.disturbances
        ),
        noise=Noise(0.01, (1e-3 * unit, 1e-3, 1e-2, 1e-2)),
    )
    found = design(changed)
    assert found.optimum == pytest.approx(REFERENCE.optimum, rel=LEVEL)
    G, H = fault_response(REFERENCE), fault_response(found)
    H[:, :, 1 + sorted(plant.signals.y.names).index("ya")] *= unit
    assert np.abs(G - H).max() <= 3e-2 * np.abs(G).max()


@pytest.mark.parametrize("size", [1e-3, 0.1, 10.0, 1e3])
def test_the_size_of_all_disturbances_scales_the_level(size):
    plant = robot()
    changed = replace(plant, disturbances=tuple(replace(d, size=size) for d in plant.disturbances))
    # The nonlinearity does not grow with w, so γ is homogeneous of degree one in the size of w.
    assert optimum(changed) == pytest.approx(size * optimum(plant), rel=LEVEL)
    assert reconstruction_floor(changed).value == pytest.approx(size * reconstruction_floor(plant).value, rel=1e-8)


@pytest.mark.parametrize("size", [1e-3, 10.0])
def test_the_size_of_all_faults_divides_the_level(size):
    plant = robot()
    changed = replace(plant, faults=tuple(replace(f, size=size) for f in plant.faults))
    assert optimum(changed) == pytest.approx(optimum(plant) / size, rel=LEVEL)
    found = design(changed)
    assert found.level == pytest.approx(REFERENCE.level / size, rel=LEVEL)
    assert np.array_equal(found.observer.Df[:, 1:] @ plant.F_f, np.eye(2))  # the estimate stays in physical units


@pytest.mark.parametrize("coefficient", [1e-3, 50.0])
def test_a_fault_in_other_units_is_reconstructed_in_them(coefficient):
    plant = robot()
    faults = tuple(replace(f, on=dict.fromkeys(f.on, coefficient), size=1 / coefficient) for f in plant.faults)
    found = design(replace(plant, faults=faults))
    assert found.level == pytest.approx(REFERENCE.level, rel=LEVEL)
    G, H = fault_response(REFERENCE), fault_response(found) * coefficient
    assert np.abs(G - H).max() <= 3e-2 * np.abs(G).max()


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_an_extra_healthy_sensor_never_raises_the_optimum(seed):
    rng = np.random.default_rng(seed)
    plant = robot()
    row = rng.normal(size=(1, 4))
    y = plant.signals.y
    more = replace(
        plant,
        signals=Signals(plant.signals.x, plant.signals.u, Channels((*y.names, "extra"))),
        operating_point=None,
        C=np.vstack([plant.C, row]),
        D=np.zeros((5, 1)),
        disturbances=(*plant.disturbances, Disturbance("n_extra", {}, {"extra": float(rng.uniform(0.05, 2.0))})),
        noise=None,
    )
    assert optimum(more) <= optimum(plant) * (1 + LEVEL)
    assert reconstruction_floor(more).value <= reconstruction_floor(plant).value * (1 + 1e-8)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
def test_floor_optimum_and_level_are_in_this_order(seed, n):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    x, y = Channels(tuple(f"x{k}" for k in range(n))), Channels(("h1", "h2", "s"))
    plant = Plant(
        "random",
        Signals(x, Channels(()), y),
        A,
        np.zeros((n, 0)),
        rng.normal(size=(3, n)),
        np.zeros((3, 0)),
        faults=(FaultChannel("f", {"s": 1.0}),),
        disturbances=(
            Disturbance("w", {f"x{k}": float(v) for k, v in enumerate(rng.normal(size=n))}),
            *(Disturbance(f"n_{s}", {}, {s: float(rng.uniform(0.1, 1.0))}) for s in y.names),
        ),
    )
    assume(not detectability_findings(plant))
    try:
        found = design(plant)
    except FaultreconError as refusal:
        raise AssertionError(f"a detectable linear plant has a design: {refusal}") from refusal
    # A linear plant: the theorem is the plain H-infinity filter with K₁ = 0, so optimum >= floor, not equality.
    assert found.floor <= found.optimum * (1 + LEVEL)
    assert found.optimum < found.level
    assert found.verification.verdict == "proved"


# ---------------------------------------------------------------- the reported noise


def test_the_reported_noise_is_what_a_long_run_shows():
    found = design(replace(robot(), nonlinearity=None))
    o, plant, h = found.observer, found.plant, 0.01
    from scipy.linalg import expm

    n, m = o.A.shape[0], o.B.shape[1]
    step = expm(np.block([[o.A, o.B], [np.zeros((m, n + m))]]) * h)
    Ad, Bd = step[:n, :n], step[:n, n:]
    rng = np.random.default_rng(3)
    runs, steps = 400, 3000
    z, total, count = np.zeros((runs, n)), np.zeros(2), 0
    for k in range(steps):
        v = np.hstack([np.zeros((runs, o.inputs)), rng.normal(size=(runs, 4)) * plant.noise.sd])
        if k >= steps // 3:  # the slowest pole has died out by then
            f = z @ o.Cf.T + v @ o.Df.T
            total += np.sum(f**2, axis=0)
            count += runs
        z = z @ Ad.T + v @ Bd.T
    measured = np.sqrt(total / count)
    reported = found.details.noise_sd
    # 400 independent runs with at least a few independent samples each: below 3 % with certainty.
    assert np.allclose(measured, [reported["fa"], reported["fb"]], rtol=0.03)


def test_the_reported_noise_is_none_where_none_is_declared_and_grows_with_it():
    assert design(robot(noisy=False)).details.noise_sd is None
    plant = REFERENCE.plant
    louder = replace(plant, noise=Noise(0.01, tuple(3.0 * s for s in plant.noise.sd)))
    one, three = fault_noise(plant, REFERENCE.observer), fault_noise(louder, REFERENCE.observer)
    assert all(three[k] == pytest.approx(3.0 * one[k], rel=1e-9) for k in one)


def test_the_second_criterion_never_costs_noise():
    plant = robot()
    quiet, small = design(plant), design(replace(plant, noise=None))
    at_small = fault_noise(plant, small.observer)
    assert sum(v**2 for v in quiet.details.noise_sd.values()) <= 1.05 * sum(v**2 for v in at_small.values())
