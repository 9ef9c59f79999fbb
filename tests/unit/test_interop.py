# SPDX-License-Identifier: BSD-3-Clause
import subprocess
import sys
import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from faultrecon.finding import InputError, MissingExtra
from faultrecon.io.library import read_library
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.interop import plant_from_control, plant_from_scipy, plant_to_control, plant_to_scipy
from faultrecon.plant.matrices import FindingWarning, left_behind, plant_from_matrices, plant_matrices
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


def spring(**changes):
    """A mass on a spring, two sensors, with everything a linear plant can have; D is not zero."""
    plain = Plant(
        name="mass on a spring",
        signals=Signals(
            Channels.declared(["position [m]", "velocity [m/s]"], {"position": 0.1}),
            Channels.declared(["force [N]"]),
            Channels.declared(["position_a [m]", "acceleration [m/s^2]"]),
        ),
        A=np.array([[0.0, 1.0], [-10.0, -0.5]]),
        B=np.array([[0.0], [2.0]]),
        C=np.array([[1.0, 0.0], [-10.0, -0.5]]),
        D=np.array([[0.0], [2.0]]),
        faults=(FaultChannel("drift", {"position_a": 1.0}), FaultChannel("leak", {"force": -0.5}, site="actuator")),
        disturbances=(
            Disturbance("unknown force", {"velocity": 2.0}, {"acceleration": 2.0}, size=0.1),
            Disturbance("hum", {}, {"position_a": 1.0}, role="noise"),
        ),
        noise=Noise(0.01, (1e-3, 1e-2)),
        operating_point=OperatingPoint((0.5, 0.0), (5.0,), (0.5, 0.0)),
    )
    return replace(plain, **changes)


def bare(**changes):
    """The same with nothing but matrices and names."""
    names = Signals(Channels.declared(["position [m]", "velocity [m/s]"]), spring().signals.u, spring().signals.y)
    nothing = {"faults": (), "disturbances": (), "noise": None, "operating_point": None}
    return spring(**nothing | {"signals": names} | changes)


def quietly(convert, *arguments, **options):
    """Convert with every warning an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return convert(*arguments, **options)


# ---------------------------------------------------------------- python-control


@pytest.mark.parametrize("sample_time", [None, 0.02])
def test_matrices_names_units_and_time_come_back_from_python_control_to_the_last_bit(sample_time):
    plant = bare(sample_time=sample_time)
    system = quietly(plant_to_control, plant)
    assert system.input_labels == ["force [N]"] and system.dt == (sample_time or 0)
    assert np.array_equal(system.D, plant.D)
    assert quietly(plant_from_control, system).digest() == plant.digest()


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_any_linear_plant_comes_back_from_python_control_scipy_and_plain_matrices(data):
    n, m, p = (data.draw(st.integers(1, 4)) for _ in range(3))
    A, B, C, D = (
        np.array(data.draw(st.lists(NUMBERS, min_size=r * c, max_size=r * c))).reshape(r, c)
        for r, c in ((n, n), (n, m), (p, n), (p, m))
    )
    h = data.draw(st.none() | st.floats(1e-3, 10))
    plant = plant_from_matrices(A, B, C, D, sample_time=h, name="any")
    assert quietly(plant_from_control, plant_to_control(plant)).digest() == plant.digest()
    assert quietly(plant_from_scipy, plant_to_scipy(plant), name="any").digest() == plant.digest()
    parts = plant_matrices(plant) if h is None else (*plant_matrices(plant), h)
    assert plant_from_scipy(parts, name="any").digest() == plant.digest()


def test_disturbances_and_faults_go_over_as_inputs_and_come_back_by_name():
    plant = bare(
        faults=(FaultChannel("drift", {"position_a": 2.0}),),
        disturbances=(Disturbance("gust", {"velocity": 2.0}, {"acceleration": 2.0}),),
    )
    with pytest.warns(FindingWarning, match="sizes"):
        system = plant_to_control(plant, inputs=("u", "disturbances", "faults"))
    assert system.input_labels == ["force [N]", "gust", "drift"]
    assert np.array_equal(system.B, [[0, 0, 0], [2, 2, 0]]) and np.array_equal(system.D, [[0, 0, 2], [2, 2, 0]])
    again = quietly(plant_from_control, system, disturbances=["gust"], faults=["drift"])
    assert again.digest() == plant.digest()


def test_an_actuator_fault_enters_through_its_column_of_B():
    with pytest.warns(FindingWarning):
        system = plant_to_control(spring(), inputs=("faults",))
    assert np.array_equal(system.B, np.hstack([[[0.0], [0.0]], [[0.0], [-1.0]]]))  # -0.5 of B = 2


def test_the_response_of_the_converted_system_is_that_of_the_plant():
    with pytest.warns(FindingWarning):
        system = plant_to_control(spring(), inputs=("u", "disturbances"))
    for s in (1j, 3.0 + 2j):
        B = np.hstack([spring().B, [[0.0, 0.0], [2.0, 0.0]]])
        D = np.hstack([spring().D, [[0.0, 1.0], [2.0, 0.0]]])
        expected = spring().C @ np.linalg.solve(s * np.eye(2) - spring().A, B) + D
        assert system(s) == pytest.approx(expected, rel=1e-12)  # condition numbers below 100


def test_what_matrices_cannot_hold_is_told_in_one_warning_and_by_a_function():
    with pytest.warns(FindingWarning) as heard:
        plant_to_control(spring())
    text = str(heard[0].message)
    assert len(heard) == 1 and heard[0].filename == __file__
    words = ["operating point", "unknown force, hum", "drift, leak", "noise", "ranges", "subtract plant.point"]
    assert all(word in text for word in words)
    assert left_behind(bare()) == []
    assert [f.severity for f in left_behind(spring())] == ["warning", "warning"]


def test_a_nonlinear_plant_is_refused_with_the_way_out():
    plant = read_library("lipschitz_polynomial")
    for convert in (plant_to_control, plant_to_scipy, plant_matrices):
        with pytest.raises(InputError, match=r"nonlinear part φ: .* another plant; convert linearised\(plant, x, u\)"):
            convert(plant)


def test_a_multiplicative_fault_is_no_input():
    plant = bare(faults=(FaultChannel("gain", {"position_a": 1.0}, effect="multiplicative"),))
    with pytest.raises(InputError, match="'gain' is multiplicative"):
        plant_to_control(plant, inputs=("u", "faults"))


def test_labels_python_control_made_up_become_numbered_names():
    system = control.ss([[0, 1], [-1, -1]], [[0], [1]], [[1, 0]], [[0]], name="pendulum")
    plant = quietly(plant_from_control, system)
    assert plant.signals.x.names == ("x1", "x2") and plant.signals.u.names == ("u1",)
    assert plant.signals.y.names == ("y1",) and plant.name == "pendulum" and plant.sample_time is None


def test_labels_that_are_no_names_are_changed_and_told():
    system = control.ss([[-1]], [[1]], [[1]], [[0]], inputs=["pitch rate"], outputs=["2nd"], states=["time [s]"])
    with pytest.warns(FindingWarning, match="'time' is now 'x_time', 'pitch rate' is now 'pitch_rate', '2nd' is now"):
        plant = plant_from_control(system)
    assert (plant.signals.x.texts(), plant.signals.y.texts()) == (["x_time [s]"], ["y_2nd"])


def test_labels_that_would_read_alike_are_numbered_and_told():
    system = control.ss([[-1]], [[1, 2]], [[1]], [[0, 0]], inputs=["a b", "a-b"], outputs=["y"], states=["x"])
    with pytest.warns(FindingWarning, match="u is numbered"):
        assert plant_from_control(system).signals.u.names == ("u1", "u2")


def test_a_unit_with_a_dot_stays_behind_and_is_told():
    s = Signals(Channels.declared(["v [m.s-1]"]), Channels.declared(["u"]), Channels.declared(["y"]))
    plant = Plant("dotted", s, *(np.ones((1, 1)) for _ in "ABCD"))
    with pytest.warns(FindingWarning, match=r"v \[m.s-1\]"):
        system = plant_to_control(plant)
    assert system.state_labels == ["v"]
    assert quietly(plant_to_control, plant, units=False).state_labels == ["v"]


def test_a_transfer_function_is_realised_and_its_states_are_said_to_mean_nothing():
    for system, convert in (
        (control.tf([1], [1, 2, 1]), plant_from_control),
        (signal.lti([1], [1, 2, 1]), plant_from_scipy),
        (signal.ZerosPolesGain([], [-1, -1], 1), plant_from_scipy),
    ):
        with pytest.warns(FindingWarning, match="no physical quantities"):
            plant = convert(system)
        at = 1j
        value = (plant.C @ np.linalg.solve(at * np.eye(plant.n) - plant.A, plant.B) + plant.D)[0, 0]
        assert value == pytest.approx(1 / (at + 1) ** 2, rel=1e-9)


def test_a_time_base_left_open_is_refused():
    for dt in (True, None):
        system = control.ss([[0.5]], [[1]], [[1]], [[0]], dt)
        with pytest.raises(InputError, match=rf"time base is not specified \(dt = {dt}\)"):
            plant_from_control(system)
    with pytest.raises(InputError, match="dt = True"):
        plant_from_scipy(signal.StateSpace([[0.5]], [[1]], [[1]], [[0]], dt=True))


@pytest.mark.parametrize(
    ("convert", "thing"),
    [
        (plant_from_control, 3),
        (plant_from_control, control.nlsys(lambda t, x, u, p: -x, None, states=1, inputs=1)),
        (plant_from_scipy, "A"),
        (plant_from_scipy, ([1], [1, 1])),
        (plant_from_scipy, ([[-1]], [[1]], [[1]])),
    ],
)
def test_what_is_no_linear_state_space_system_is_refused_with_a_remedy(convert, thing):
    with pytest.raises(InputError) as refused:
        convert(thing)
    assert refused.value.finding.remedies


def test_a_plant_without_inputs_goes_to_scipy_and_not_to_python_control():
    plant = plant_from_matrices([[-1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)))
    assert plant_to_scipy(plant).B.shape == (1, 0)
    with pytest.raises(InputError, match="has no input among u"):
        plant_to_control(plant)


def test_without_python_control_the_extra_is_named():
    code = (
        "import sys; sys.modules['control'] = None\n"
        "from faultrecon.plant.interop import plant_from_control\n"
        "from faultrecon.finding import MissingExtra\n"
        "try: plant_from_control(1)\n"
        "except MissingExtra as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 'pip install "faultrecon[interop]"' in done.stdout
    assert issubclass(MissingExtra, ImportError)


# ---------------------------------------------------------------- matrices


def test_vectors_and_a_zero_stand_for_matrices_where_that_is_clear():
    plant = plant_from_matrices([[0, 1], [-1, -1]], [0, 1], [1, 0], 0)
    assert (plant.B.shape, plant.C.shape, plant.D.shape) == ((2, 1), (1, 2), (1, 1))


def test_a_fault_given_as_text_is_an_additive_fault_on_that_sensor():
    plant = plant_from_matrices([[-1]], [[1]], [[1], [1]], [[0], [0]], outputs=["a", "b"], faults=["b"])
    assert plant.faults == (FaultChannel("b", {"b": 1.0}),) and plant.signals.u.names == ("u1",)


def test_an_input_that_moves_states_is_no_sensor_fault():
    with pytest.raises(InputError, match=r"'u1' moves the states.*site='actuator'"):
        plant_from_matrices([[-1]], [[1]], [[1]], [[0]], faults=["u1"])


@pytest.mark.parametrize(
    ("matrices", "words"),
    [
        (([[1j]], [[1]], [[1]], [[0]]), "A is complex"),
        (([[-1]], [["x"]], [[1]], [[0]]), "B is no matrix of numbers"),
        (([[-1]], [[1]], [[np.nan]], [[0]]), "matrices.C"),
        (([[-1, 0]], [[1]], [[1]], [[0]]), r"A is \(1, 2\)"),
        (([[-1]], [[1], [1]], [[1]], [[0]]), r"B is \(2, 1\)"),
        (([[[1]]], [[1]], [[1]], [[0]]), "A has 3 dimensions"),
        (([[-1]], [[1]], [[1]], [[0, 0]]), r"D is \(1, 2\): 1 rows of A"),
    ],
)
def test_matrices_that_make_no_plant_are_named(matrices, words):
    with pytest.raises(InputError, match=words):
        plant_from_matrices(*matrices)


def test_misspelt_names_get_a_suggestion():
    with pytest.raises(InputError, match="did you mean 'gust'"):
        plant_from_matrices([[-1]], [[1]], [[1]], [[0]], inputs=["gust"], disturbances=["gusd"])
    with pytest.raises(InputError, match="did you mean 'faults'"):
        plant_matrices(bare(), inputs=("fault",))
    with pytest.raises(InputError, match="2 names are given for y"):
        plant_from_matrices([[-1]], [[1]], [[1]], [[0]], outputs=["a", "b"])
