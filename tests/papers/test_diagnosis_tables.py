# SPDX-License-Identifier: BSD-3-Clause
"""Existence and floors against independently computed tables: aircraft, robot arm, counterexamples.

Sources: Khosrowjerdi 2011 (floors of the two examples), Alwi, Edwards and Tan 2009 (pitch-rate sensor of an unstable
aircraft), Huang, Gao and Liu 2024 (unknown-input decoupling), Jia et al. 2015 (disturbance directions of a robot).
"""

import warnings

import numpy as np
import pytest

from faultrecon.diagnosis.conditions import constant_fault, constant_fault_matrix, detectable
from faultrecon.diagnosis.diagnosis import diagnose
from faultrecon.diagnosis.existence import assumptions, decoupling_findings, detectability_findings
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.diagnosis.sensors import fault_sets, what_would_help
from faultrecon.io.library import read_library
from faultrecon.numerics.pencil import distance_to_undetectability, unobservable_modes
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Channels, Signals

AIRCRAFT = np.array(
    [
        [-0.5432, 0.0137, 0, 0.9778, 0],
        [0, -0.1179, 0.2215, 0, -0.9661],
        [0, -10.5128, -0.9967, 0, 0.6176],
        [2.6221, -0.0030, 0, -0.5057, 0],
        [0, 0.7075, -0.0939, 0, -0.2127],
    ]
)
STATES = ("alpha", "beta", "p", "q", "r")
ROBOT = [[0, 1, 0, 0], [-48.6, -1.25, 48.6, 0], [0, 0, 0, 1], [19.5, 0, -19.5, 0]]


def aircraft(*faulty):
    """Rates p, q, r measured; the named ones may fail."""
    signals = Signals(Channels(STATES), Channels(()), Channels(("y_p", "y_q", "y_r")))
    faults = tuple(FaultChannel(name, {f"y_{name}": 1.0}) for name in faulty)
    return Plant("aircraft", signals, AIRCRAFT, np.zeros((5, 0)), np.eye(5)[2:], np.zeros((3, 0)), faults=faults)


def decoupling(A, C, D1, faults, B=None):
    """A plant whose disturbances D1 are to be decoupled; faults: "u1" for the actuator, "y2" for a sensor."""
    A, C = np.asarray(A, dtype=float), np.asarray(C, dtype=float)
    n, p = A.shape[0], C.shape[0]
    B = np.zeros((n, 0)) if B is None else np.reshape(np.asarray(B, dtype=float), (n, -1))
    x, u, y = (tuple(f"{k}{i + 1}" for i in range(m)) for k, m in (("x", n), ("u", B.shape[1]), ("y", p)))
    D1 = np.reshape(np.asarray(D1, dtype=float), (n, -1))
    disturbances = tuple(
        Disturbance(f"d{j + 1}", {x[i]: D1[i, j] for i in range(n)}, role="decouple") for j in range(D1.shape[1])
    )
    channels = tuple(FaultChannel(f"f_{k}", {k: 1.0}, site="actuator" if k[0] == "u" else "sensor") for k in faults)
    signals = Signals(Channels(x), Channels(u), Channels(y))
    return Plant("p", signals, A, B, C, np.zeros((p, len(u))), faults=channels, disturbances=disturbances)


@pytest.mark.parametrize(("name", "floor"), [("lipschitz_aircraft", 0.487601), ("lipschitz_polynomial", 0.587324)])
def test_the_floor_of_the_published_examples(name, floor):
    found = reconstruction_floor(read_library(name))
    assert found.kind == "disturbance"
    assert found.value == pytest.approx(floor, rel=1e-5)  # six digits are tabulated


# faulty, distance of (A, C1) and where, sigma_min at the origin in canonical coordinates, floor in seconds
TABLE = [
    (("q",), 0.0, 1.076874746j * -1j, 0.8414, 0.9286131034),
    (("r",), 0.8449, None, 0.9362, 0.0),
    (("p",), 0.1443, 1.633j, 0.2427, 0.0),
    (("q", "r"), 0.0, 1.076874746j * -1j, 0.8414, 0.9286131034),
    (("p", "r"), 0.0927, 1.664j, 0.2713, 0.0),
]


@pytest.mark.parametrize(("faulty", "distance", "where", "origin", "floor"), TABLE)
def test_the_existence_table_of_the_unstable_aircraft(faulty, distance, where, origin, floor):
    plant = aircraft(*faulty)
    index = [STATES.index(name) for name in faulty]
    healthy = np.eye(5)[[i for i in (2, 3, 4) if i not in index]]
    value, s = distance_to_undetectability(AIRCRAFT, healthy)
    assert value == pytest.approx(distance, abs=5e-5)  # four digits are tabulated
    assert where is None or s == pytest.approx(where, abs=1e-3)
    # With y2 = C2 x + f for a state, in place of f: the coordinates of the table.
    q, C2 = len(index), np.eye(5)[index]
    M = np.block([[AIRCRAFT, np.zeros((5, q))], [C2 @ AIRCRAFT, np.zeros((q, q))], [healthy, np.zeros((3 - q, q))]])
    M = np.vstack([M, np.hstack([np.zeros((q, 5)), np.eye(q)])])
    assert np.linalg.svd(M, compute_uv=False)[-1] == pytest.approx(origin, abs=5e-5)
    assert constant_fault(plant).holds
    assert detectable(plant).holds == (floor == 0)
    limit = reconstruction_floor(plant)
    assert (limit is None) == (floor == 0)
    assert limit is None or limit.value == pytest.approx(floor, abs=1e-9)


def test_the_pitch_rate_sensor_hides_both_longitudinal_modes():
    modes = unobservable_modes(AIRCRAFT, np.eye(5)[[2, 4]])
    assert [m.value for m in modes] == pytest.approx([1.076874746, -2.125774746], abs=1e-9)
    (found,) = detectability_findings(aircraft("q"))
    assert set(found.evidence["states"]) == {"alpha", "q"}


def test_the_noise_that_the_published_level_costs():
    # ||G|| = 1/λ + 1/a and F(inf) = a/λ with the printed level 1.2212.
    limit = reconstruction_floor(aircraft("q"))
    assert limit.noise_gain(1.2212) == pytest.approx(3.174, abs=5e-4)
    assert limit.noise_gain(limit.value) == np.inf


def test_the_diagnosis_of_the_hidden_mode_says_what_is_left():
    text = str(diagnose(aircraft("q")))
    assert "cannot be reconstructed" in text
    assert "at best an error of 0.928613 s times the rate of the fault" in text


def test_the_table_of_combinations_of_the_aircraft():
    rows = {row.faults: row.reconstructible for row in fault_sets(aircraft("p", "q", "r"), largest=3)}
    assert rows == {
        ("p",): True,
        ("q",): False,
        ("r",): True,
        ("p", "q"): False,
        ("p", "r"): True,
        ("q", "r"): False,
        ("p", "q", "r"): False,
    }
    assert {option.name for option in what_would_help(aircraft("q"))} == {"alpha", "q"}


def test_a_hidden_zero_of_the_decoupled_plant_is_refused():
    # All printed assumptions hold, but TA has the eigenvalue 1 where C sees nothing.
    plant = decoupling([[-2, 1, 0], [-1, 0, 0], [1, 0, -3]], [[1, 0, 0], [0, 0, 1]], [1, -1, 0], ["y2"])
    (found,) = decoupling_findings(plant)
    assert found.what == "(A, E_d, C) minimum phase fails at s = 1: rank 3 of 4"


def test_a_bias_that_equals_a_constant_disturbance_is_refused():
    plant = decoupling([[-2, 1, 0], [-1, 0, 0], [1, 1, -3]], [[1, 0, 0], [0, 0, 1]], [1, 0, 0], ["y2"])
    (found,) = decoupling_findings(plant)
    assert found.what == "[A, E; C, F] of full column rank (s = 0) fails: rank 4 of 5"


def gains_exist(plant):
    """Whether a second solver finds P > 0 and gains that stabilise (blkdiag(TA, 0), [C D]), full P (Huang 2024)."""
    import cvxpy as cp

    Bd, C, D = plant.E_w, plant.C, plant.F_f
    T = np.eye(plant.n) - Bd @ np.linalg.pinv(C @ Bd) @ C
    q = D.shape[1]
    A = np.block([[T @ plant.A, np.zeros((plant.n, q))], [np.zeros((q, plant.n + q))]])
    both = np.hstack([C, D])
    P, Y = cp.Variable(A.shape, symmetric=True), cp.Variable((A.shape[0], C.shape[0]))
    X = P @ A + A.T @ P - Y @ both - both.T @ Y.T
    # Homogeneous: P >= I and X <= -I are no loss.
    problem = cp.Problem(cp.Minimize(cp.trace(P)), [P >> np.eye(A.shape[0]), X << -np.eye(A.shape[0])])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an inaccurate point is judged by its own eigenvalues
        problem.solve(solver=cp.CLARABEL)
    if P.value is None:
        return False
    return bool(np.linalg.eigvalsh(P.value).min() > 0.5 and np.linalg.eigvalsh(X.value).max() < -0.5)


FLIGHT = [[-0.6803, 2e-4, -1.0490, 0], [-0.1463, -0.0062, -4.6726, -9.7942], [1.005, -6e-4, -0.5717, 0], [1, 0, 0, 0]]
ARM = [[0, 1, 0, 0], [-48.6, -1.25, 48.6, 0], [0, 0, 0, 10], [1.95, 0, -1.95, 0]]
TWO_OF_THREE = [[1, 0, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("A", "C", "D1", "fault", "possible"),
    [
        ([[-2, 1, 0], [-1, 0, 0], [1, 0, -3]], TWO_OF_THREE, [1, -1, 0], "y2", False),
        ([[-2, 1, 0], [-1, 0, 0], [1, 1, -3]], TWO_OF_THREE, [1, 0, 0], "y2", False),
        (FLIGHT, np.eye(4)[[0, 1, 3]], [1, -1, 1, 1], "y3", True),
        (ARM, np.eye(4)[:3], [0.5, 1, 0.5, 1], "y1", True),
    ],
)
def test_the_conditions_and_the_inequality_of_a_second_solver_agree(A, C, D1, fault, possible):
    plant = decoupling(A, C, D1, [fault])
    assert (decoupling_findings(plant) == []) == possible
    assert gains_exist(plant) == possible


def robot(D1, faults=("u1",)):
    return decoupling(ROBOT, np.eye(4)[:3], D1, faults, [0, 21.6, 0, 0])


E2, E4 = np.eye(4)[:, 1], np.eye(4)[:, 3]


@pytest.mark.parametrize(
    ("direction", "reason"),
    [
        (E2, "rank(J E_f) = q fails: rank 1 of 2"),
        (E4, "rank(C E_d) = rank(E_d) fails: rank 0 of 1"),
        (np.eye(4)[:, [0, 2]], "[A, E; C, F] of full column rank (s = 0) fails: rank 6 of 7"),
    ],
)
def test_adverse_disturbance_directions_are_refused_for_the_right_reason(direction, reason):
    (found,) = decoupling_findings(robot(direction))
    assert found.what == reason


@pytest.mark.parametrize(
    ("direction", "faults", "sigma"),
    [
        ([0.2, 2.0, 0.1, 0.3], ("u1",), 0.13921),
        (E2 - 0.4 * E4, ("u1",), 0.0145),
        ([0.2, 2.0, 0.1, 0.3], ("u1", "y1"), 0.13878),
        ([0.2, 2.0, 0.1, 0.3], ("u1", "y2"), 0.01032),
        ([0.2, 2.0, 0.1, 0.3], ("u1", "y3"), 0.13878),
    ],
)
def test_admissible_directions_are_accepted_with_their_distance(direction, faults, sigma):
    plant = robot(direction, faults)
    assert decoupling_findings(plant) == []
    assert all(c.holds and c.distance > 0 for c in assumptions(plant) if c.name != "(A, C1) detectable")
    # Printed with three to five digits.
    assert np.linalg.svd(constant_fault_matrix(plant), compute_uv=False)[-1] == pytest.approx(sigma, rel=1e-3)


@pytest.mark.parametrize(("sensors", "possible"), [((1, 2), True), ((2, 3), True), ((1, 3), False)])
def test_two_sensors_beside_the_actuator(sensors, possible):
    # A common shift of both encoders is the null vector [1 0 1 0] of A.
    plant = robot(np.zeros((4, 0)), ("u1", *(f"y{j}" for j in sensors)))
    assert diagnose(plant).together.possible == possible
