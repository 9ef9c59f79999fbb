# SPDX-License-Identifier: BSD-3-Clause
"""What a certificate promises holds in simulation, whatever the disturbance, the fault and the start."""

from dataclasses import replace
from functools import cache

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.io.library import read_library
from faultrecon.simulation.chance import HeldNoise
from faultrecon.simulation.run import simulate
from faultrecon.simulation.scenario import Scenario
from faultrecon.simulation.shapes import Ramp, Sine, Spike, Step
from faultrecon.synthesis.pipeline import design

SAMPLING = 1e-3
"""What sampling may add to the gain, relative: steps of a hundredth of the time constants, trapezoidal energies."""

times = st.floats(0.0, 6.0)
# None or at least 1e-6: the truth is integrated to an absolute tolerance, which decides about anything far below.
sizes = st.one_of(st.just(0.0), st.floats(1e-6, 2.0), st.floats(-2.0, -1e-6))
waves = st.one_of(
    st.builds(Step, sizes),
    st.builds(Sine, sizes, st.floats(0.1, 20.0), st.floats(0.0, 6.3)),
    st.builds(Ramp, sizes, st.floats(0.1, 5.0)),
    st.builds(Spike, sizes, st.floats(0.1, 2.0)),
    st.builds(HeldNoise, st.one_of(st.just(0.0), st.floats(1e-6, 2.0)), st.sampled_from([0.05, 0.2, 1.0])),
)
starts = st.one_of(st.just(0.0), st.floats(1e-6, 0.05), st.floats(-0.05, -1e-6))
shapes = st.builds(lambda wave, t: wave.starting(t), waves, times)


@cache
def _airliner():
    return design(read_library("airliner"))


@cache
def _polynomial():
    return design(read_library("lipschitz_polynomial"))


def _scaled(shape, by: float):
    kind = "amplitude" if isinstance(shape.shape, Sine) else "sd" if isinstance(shape.shape, HeldNoise) else "size"
    return replace(shape.shape, **{kind: by * getattr(shape.shape, kind)}).starting(shape.start)


@given(
    st.lists(st.tuples(st.integers(0, 16), shapes), max_size=3),
    shapes,
    st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
    st.booleans(),
    st.integers(0, 2**32),
)
@settings(max_examples=30, deadline=None)
def test_a_linear_plant_never_exceeds_the_certified_level(disturbances, fault, error, noise, seed):
    plant = _airliner().plant
    acting = {plant.attenuated[k].name: _scaled(shape, plant.attenuated[k].size) for k, shape in disturbances}
    scenario = Scenario(
        duration=10.0,
        faults={"pitch_rate": _scaled(fault, 0.04)},
        disturbances=acting,
        initial_error=np.array(error) * np.array(plant.signals.x.ranges),
        noise=noise,  # every sensor's is declared as a disturbance, so it is counted
        seed=seed,
    )
    score = simulate(_airliner(), scenario).score()
    assert score.outside == ()
    assert score.achieved is None or score.achieved <= score.level * (1 + SAMPLING)


@given(shapes, shapes, shapes, st.tuples(starts, starts), st.integers(0, 2**32))
@settings(max_examples=25, deadline=None)
def test_a_nonlinear_plant_in_its_domain_never_exceeds_the_certified_level(w1, w2, fault, error, seed):
    scenario = Scenario(
        duration=8.0,
        sample_time=0.01,
        faults={"f": fault},
        disturbances={"w1": _scaled(w1, 0.02), "w2": _scaled(w2, 0.02)},
        initial_error=error,
        noise=False,
        seed=seed,
    )
    score = simulate(_polynomial(), scenario).score()
    assert score.outside == ()
    assert score.achieved is None or score.achieved <= score.level * (1 + SAMPLING)


@given(shapes, shapes, st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_shapes_are_what_they_are_from_the_right(first, second, seed):
    shape = (first + second).seeded(lambda label: seed)
    edges = np.array(shape.breakpoints(8.0))
    edges = edges[np.append(np.diff(edges) > 1e-9, True)]  # two jumps at once have no value in between
    after = shape(np.nextafter(edges, np.inf))
    # Slopes and waves of these sizes move by far less than 1e-9 in one unit in the last place.
    assert np.max(np.abs(shape(edges) - after)) < 1e-9


@given(shapes, st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_a_bound_on_size_holds(shape, seed):
    seeded = shape.seeded(lambda label: seed)
    t = np.linspace(0.0, 10.0, 400)
    assert np.max(np.abs(seeded(t))) <= seeded.bounded.size * (1 + 1e-12)


@given(shapes, st.integers(0, 2**32))
@settings(max_examples=10, deadline=None)
def test_what_is_reconstructed_in_quiet_is_the_fault_itself(fault, seed):
    run = simulate(_airliner(), Scenario(duration=4.0, faults={"roll_rate": fault}, noise=False, seed=seed))
    assert np.max(np.abs(run.f - run.f_hat)) < 1e-11
