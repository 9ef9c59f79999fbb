# SPDX-License-Identifier: BSD-3-Clause
"""Huang 2024: identities, refusals, pole-bound and noise tables, printed gains and zeros of our re-derivation."""

from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest

from faultrecon.advise.papers._huang2024_designs import F_SIGNS, printed_augmented, printed_observer
from faultrecon.advise.papers._huang2024_runs import estimates, finer, log_of, marks, robot_log, until
from faultrecon.diagnosis.decoupling import unknown_input_gain, zeros_to_errors
from faultrecon.finding import Impossible, InputError
from faultrecon.graph.function import Graph
from faultrecon.io.library import read_library
from faultrecon.lmi.expr import Inequality, let
from faultrecon.lmi.problem import Problem
from faultrecon.lmi.solve import solve
from faultrecon.lmi.walk import substitute, value_of
from faultrecon.methods.errors_uio import error_letters
from faultrecon.methods.registry import method
from faultrecon.numerics.hinf import hinf_norm
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.matrices import plant_from_matrices
from faultrecon.plant.signals import Noise
from faultrecon.runtime.estimator import Estimator, rk4_limit
from faultrecon.synthesis.certify import certificate, proof_inequalities, prove, shipped
from faultrecon.synthesis.levels import INSIDE, multipliers, pose
from faultrecon.synthesis.pipeline import design, optimum

AIRCRAFT = read_library("civil_aircraft")
ROBOT = read_library("flexible_joint")


def as_printed(robot):
    """The robot with |ψ(a) - ψ(b)| <= θ |a - b| in R⁴: no structure of ψ is used."""
    names, term = robot.signals.x.names, robot.nonlinearity
    phi = Graph.from_texts(
        ["0*x1", "0*x2", "0*x3", "-0.333*sin(x3)"], {"x": list(names), "u": list(robot.signals.u.names), "t": ["t"]}
    )
    return replace(robot, nonlinearity=replace(term, into=np.eye(4), reads=names, phi=phi))


ROBOT_AS_PRINTED = as_printed(ROBOT)


def with_d2(plant, *signs):
    """The plant with other signs of Bd2, in the order of its states."""
    d1, d2 = plant.disturbances
    sizes = [(name, abs(v)) for name, v in d2.into.items()]
    return replace(
        plant, disturbances=(d1, replace(d2, into={n: s * v for (n, v), s in zip(sizes, signs, strict=True)}))
    )


# ---------------------------------------------------------------- the observer of the printed gains (test 1)

L1_AIRCRAFT = 1e3 * np.array(
    [[3.6706, -0.1416, -0.7720], [-0.1834, 2.9668, 0.0010], [2.2772, -1.2722, -0.4654], [0.8820, -2.4025, -0.1584]]
)
N_AIRCRAFT = 1e3 * np.array(
    [
        [-3.6714, 0.1416, -0.0023, 0.7687],
        [0.1834, -2.9668, -0.0035, -0.0075],
        [-2.2764, 1.2722, -0.0018, 0.4621],
        [-0.8812, 2.4025, -0.0012, 0.1552],
    ]
)
F_AIRCRAFT = 1e5 * np.array([[-0.6781, 2.5525, 2.5825]])
L1_ROBOT = np.array(
    [
        [136.1849, -122.3783, 184.5829],
        [-18.7326, 82.5755, 24.8910],
        [22.2723, -8.1410, 97.7857],
        [9.2067, -8.4649, 214.8044],
    ]
)
N_ROBOT = np.array(
    [
        [-119.985, 123.628, -200.783, -1.6667],
        [2.5326, -83.3255, -8.6910, -3.3333],
        [-6.0723, 8.3910, -113.986, 8.3333],
        [25.1433, 8.9649, -249.154, -3.3333],
    ]
)
L_ROBOT = np.array(
    [
        [123.377, -147.993, 171.776],
        [-48.645, 22.750, -5.022],
        [7.837, -37.011, 83.351],
        [-26.251, -79.381, 179.346],
    ]
)
F_ROBOT = 1e3 * np.array([[2.6384, 0.5372, 1.0113]])
PRINTED = {
    "civil_aircraft": (AIRCRAFT, {"L1": L1_AIRCRAFT, "F_a": F_AIRCRAFT, "Γ": np.array([[10.0]])}),
    "flexible_joint": (ROBOT, {"L1": L1_ROBOT, "F_a": F_ROBOT, "Γ": np.array([[10.0]])}),
}


@pytest.mark.parametrize("name", PRINTED)
def test_what_is_decoupled_does_not_enter_and_the_gains_compose(name):
    plant, gains = PRINTED[name]
    made, M, n = method("adaptive-uio").observer(plant, gains), unknown_input_gain(plant), plant.n
    J, N = np.eye(n) - M @ plant.C, made.A[:n, :n]
    L = made.B[:n, made.inputs :]
    size = np.abs(L).max()
    assert np.abs(J @ plant.E_w[:, 0]).max() <= 1e-10
    assert np.abs(N - (J @ plant.A - gains["L1"] @ plant.C)).max() <= 1e-10 * size
    assert np.abs(L - gains["L1"] - N @ M).max() <= 1e-10 * size
    assert np.array_equal(made.Dx[:, made.inputs :], M)


@pytest.mark.parametrize(
    ("name", "printed", "tolerance"), [("civil_aircraft", N_AIRCRAFT, 0.1), ("flexible_joint", N_ROBOT, 2e-3)]
)
def test_n_follows_from_the_printed_l1(name, printed, tolerance):
    # Half a unit of the last printed digit of N and of L1: 0.05 each for the aircraft; N of the robot has a digit less.
    plant, gains = PRINTED[name]
    made = method("adaptive-uio").observer(plant, gains)
    assert np.abs(made.A[:4, :4] - printed).max() <= tolerance


def test_the_robots_l_is_l1_plus_l2_and_not_what_is_printed():
    plant, gains = PRINTED["flexible_joint"]
    assert np.abs(method("adaptive-uio").observer(plant, gains).B[:4, 1:] - L_ROBOT).max() <= 2e-3


def test_the_printed_augmented_gains_have_the_printed_poles():
    K = np.array(
        [
            [22.1437, -26.1687, 16.471],
            [-8.8992, 8.4933, -1.8299],
            [-0.6727, -3.2402, 5.8621],
            [6.8826, -21.2249, 25.8055],
            [-4.7632, 16.9837, -22.5377],
            [-3.6654, 13.755, -17.8217],
        ]
    )
    made = method("augmented-uio").observer(ROBOT, {"K_x": K[:4], "K_g": K[4:5], "K_f": K[5:]})
    expected = [-0.543, -1.459, -8.427 - 6.791j, -8.427 + 6.791j, -9.031 - 35.852j, -9.031 + 35.852j]
    # Gains are printed to 5e-5, and the slow poles move by some tens of that.
    assert np.abs(np.sort_complex(made.poles) - np.sort_complex(np.array(expected))).max() <= 4e-3


# ---------------------------------------------------------------- the error dynamics (test 2)


def error_matrices(plant, made):
    """A, [B_f', B_w] of [e_x; f - f̂] for an adaptive observer without noise: the text of section 1, by hand."""
    M, n, q = unknown_input_gain(plant), plant.n, len(plant.faults)
    J = np.eye(n) - M @ plant.C
    attenuated = plant.E_w[:, [d.role != "decouple" for d in plant.attenuated]]
    into_f = np.vstack([-M @ plant.F_f, np.eye(q)])
    return made.A, np.hstack([into_f, np.vstack([J @ attenuated, np.zeros((q, attenuated.shape[1]))])])


@pytest.mark.parametrize("plant", [AIRCRAFT, ROBOT], ids=["aircraft", "robot"])
def test_plant_and_observer_together_obey_the_error_equation(plant):
    """Runge-Kutta commutes with the linear map from (x, z, f, f̂) to (x, e, f): both agree to rounding."""
    made = design(plant, "adaptive-uio", pole_bound=30.0).observer
    M, n, m = unknown_input_gain(plant), plant.n, plant.B.shape[1]
    J, (Ae, Be) = np.eye(n) - M @ plant.C, error_matrices(plant, made)
    term = plant.nonlinearity

    def ψ(x):
        if term is None:
            return np.zeros(n)
        return plant.G @ term.phi(x[[plant.signals.x.index(k) for k in term.reads]], np.zeros(m), [0.0])

    def inputs(t):
        return (
            np.full(m, np.sin(3 * t)),
            np.array([np.sin(10 * t)]),
            np.array([np.cos(7 * t)]),
            np.array([np.sin(2 * t)]),
        )

    def plant_rhs(t, x):
        u, d1, d2, _ = inputs(t)
        return plant.A @ x + plant.B @ u + ψ(x) + plant.E_w @ np.concatenate([d1, d2])

    def both(t, s):
        x, f, z = s[:n], s[n : n + 1], s[n + 1 :]
        v = np.concatenate([inputs(t)[0], plant.C @ x + plant.F_f @ f])
        dz = made.A @ z + made.B @ v
        dz[:n] += J @ ψ(made.Cx @ z + made.Dx @ v)
        return np.concatenate([plant_rhs(t, x), inputs(t)[3], dz])

    def errors(t, s):
        x, e = s[:n], s[n:]
        de = Ae @ e + Be @ np.concatenate([inputs(t)[3], inputs(t)[2]])
        de[:n] += J @ (ψ(x) - ψ(x - e[:n]))
        return np.concatenate([plant_rhs(t, x), de])

    def run(rhs, s, h=2e-3, steps=400):
        for k in range(steps):
            t = k * h
            k1 = rhs(t, s)
            k2 = rhs(t + h / 2, s + h / 2 * k1)
            k3 = rhs(t + h / 2, s + h / 2 * k2)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + rhs(t + h, s + h * k3))
        return s

    x0 = np.array([0.1, 0.5, -0.1, 0.1])
    end = run(both, np.concatenate([x0, np.zeros(1 + n + 1)]))
    x, f, z = end[:n], end[n : n + 1], end[n + 1 :]
    v = np.concatenate([np.zeros(m), plant.C @ x + plant.F_f @ f])  # D = 0 here, so u does not matter
    direct = np.concatenate([x - made.Cx @ z - made.Dx @ v, f - made.Cf @ z])
    derived = run(errors, np.concatenate([x0, J @ x0, np.zeros(1)]))[n:]
    assert np.abs(direct - derived).max() <= 1e-8


# ---------------------------------------------------------------- existence (test 3)


def counterexample(last_row, into):
    """Third-order, y = (x1, x3), fault on the second output, one disturbance to decouple."""
    return plant_from_matrices(
        [[-2.0, 1.0, 0.0], [-1.0, 0.0, 0.0], last_row],
        np.zeros((3, 0)),
        [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        np.zeros((2, 0)),
        states=["x1", "x2", "x3"],
        outputs=["y1", "y2"],
        faults=[FaultChannel("f", {"y2": 1.0})],
        disturbances=[Disturbance("d1", into, role="decouple")],
    )


def test_counterexample_1_is_refused_for_the_mode_of_ta_that_c_does_not_see():
    plant = counterexample([1.0, 0.0, -3.0], {"x1": 1.0, "x2": -1.0})
    with pytest.raises(Impossible, match="at s = 1: rank 3 of 4") as refused:
        design(plant, "adaptive-uio")
    assert "minimum phase" in str(refused.value)


def test_counterexample_2_is_refused_because_a_bias_equals_a_constant_disturbance():
    plant = counterexample([1.0, 1.0, -3.0], {"x1": 1.0})
    with pytest.raises(Impossible, match=r"\(s = 0\) fails: rank 4 of 5"):
        design(plant, "adaptive-uio")


@pytest.mark.parametrize("name", ["adaptive-uio-printed", "adaptive-uio-full"])
def test_no_level_exists_where_the_conditions_fail(name):
    # Every error has to count: a weight of zero leaves the boundary P v = 0 of the inequality, where a solver may stop.
    for plant in (
        counterexample([1.0, 0.0, -3.0], {"x1": 1.0, "x2": -1.0}),
        counterexample([1.0, 1.0, -3.0], {"x1": 1.0}),
    ):
        with pytest.raises(Impossible, match="no solution"):
            optimum(plant, name, fix={"W_x": np.eye(3)})


def test_both_examples_of_the_paper_are_accepted():
    assert not method("adaptive-uio").assumptions(AIRCRAFT) and not method("adaptive-uio").assumptions(ROBOT)


# ---------------------------------------------------------------- levels under a pole bound (tests 4 and 5)

FULL_ERROR, NO_LIMIT = {"W_x": np.eye(4)}, {"ρ": 1e6}
RHO = (10.0, 20.0, 30.0, 60.0, 100.0, 300.0)
COLUMNS = {
    "aircraft": (AIRCRAFT, "adaptive-uio-printed", {}),
    "aircraft full P": (AIRCRAFT, "adaptive-uio-full", {**FULL_ERROR, **NO_LIMIT}),
    "aircraft augmented": (AIRCRAFT, "augmented-uio", {**FULL_ERROR, **NO_LIMIT, "W_g": np.eye(1)}),
    "robot": (ROBOT_AS_PRINTED, "adaptive-uio-printed", {"ε": 40.0}),
    "robot full P": (ROBOT_AS_PRINTED, "adaptive-uio-full", {**FULL_ERROR, **NO_LIMIT}),
    "robot augmented": (ROBOT_AS_PRINTED, "augmented-uio", {**FULL_ERROR, **NO_LIMIT, "W_g": np.eye(1)}),
}
TABLE = {
    "aircraft": (0.12040, 0.06674, 0.04997, 0.03214, 0.02389, 0.01321),
    "aircraft full P": (0.12040, 0.06020, 0.04013, 0.02007, 0.01204, 0.00401),
    "aircraft augmented": (0.10001, 0.05004, 0.03350, 0.01804, 0.01080, None),
    "robot": (0.15866, 0.08439, 0.06069, 0.03646, 0.02828, 0.02263),
    "robot full P": (0.11377, 0.05670, 0.03776, 0.01886, 0.01152, 0.00901),
    "robot augmented": (0.12849, 0.08066, 0.06570, 0.05569, 0.05307, 0.05108),
}
LOWER = {
    # Entries of the table that are no optimum: at these levels, below them, gains are proved exactly.
    ("robot", 300.0): 0.0222,
    ("robot full P", 100.0): 0.01149,
    ("robot full P", 300.0): 0.0087,
    ("aircraft augmented", 30.0): 0.03345,
    ("aircraft augmented", 60.0): 0.0175,
    ("aircraft augmented", 100.0): 0.0107,
    ("robot augmented", 10.0): 0.1282,
    ("robot augmented", 20.0): 0.0795,
    ("robot augmented", 30.0): 0.063,
    ("robot augmented", 60.0): 0.050,
    ("robot augmented", 100.0): 0.045,
    ("robot augmented", 300.0): 0.045,
}


@cache
def bounded(column, ρ):
    plant, name, fix = COLUMNS[column]
    return optimum(plant, name, pole_bound=ρ, fix=fix)


@pytest.mark.parametrize("column", TABLE)
def test_the_pole_bound_table(column):
    for ρ, expected in zip(RHO, TABLE[column], strict=True):
        if expected is None:
            continue
        if (column, ρ) in LOWER:
            assert bounded(column, ρ) < expected
        else:
            assert bounded(column, ρ) == pytest.approx(expected, rel=2e-3), ρ


@pytest.mark.parametrize(("column", "ρ"), LOWER)
def test_levels_below_the_table_are_proved_where_it_is_no_optimum(column, ρ):
    (plant, name, fix), level = COLUMNS[column], LOWER[column, ρ]
    assert level < TABLE[column][RHO.index(ρ)]
    posed = pose(method(name), plant, fix=fix, pole_bound=ρ)
    found = solve(posed.at_level(level), margin=INSIDE, near=posed.optimum().values)
    assert found.solved
    gains = shipped(posed.theorem, found.values)
    for values in (found.values, multipliers(posed, gains, level).values):
        if prove(certificate(name, posed.theorem, plant, gains, {**posed.fixed, **values}, level)).sound:
            break
    else:
        pytest.fail("no multipliers proved it")
    poles = posed.method.observer(plant, gains).poles.real
    assert -ρ * (1 + 1e-6) < poles.min() and poles.max() < 0


@pytest.mark.parametrize("column", ["aircraft", "aircraft full P", "robot", "robot full P"])
def test_a_looser_pole_bound_never_raises_the_level(column):
    assert all(a >= b * (1 - 1e-6) for a, b in pairwise(bounded(column, ρ) for ρ in RHO))


def test_a_full_lyapunov_matrix_never_does_worse():
    # The solver is good to about 1e-6 here; at ρ = 10 both optima of the aircraft coincide.
    for ρ in RHO:
        assert bounded("aircraft full P", ρ) <= bounded("aircraft", ρ) * (1 + 1e-5)
        free = optimum(ROBOT_AS_PRINTED, "adaptive-uio-printed", pole_bound=ρ)
        assert bounded("robot full P", ρ) <= free * (1 + 1e-5)


def test_the_robot_at_30_with_epsilon_free():
    assert optimum(ROBOT_AS_PRINTED, "adaptive-uio-printed", pole_bound=30.0) == pytest.approx(0.04811, rel=2e-3)


def test_the_structure_of_psi_can_only_help():
    plain = optimum(ROBOT_AS_PRINTED, "adaptive-uio-printed", pole_bound=30.0)
    assert optimum(ROBOT, "adaptive-uio-printed", pole_bound=30.0) <= plain * (1 + 1e-6)


def test_the_papers_level_needs_poles_of_ten_not_of_millions():
    made = design(AIRCRAFT, "adaptive-uio-printed", level=0.13, pole_bound=10.0)
    assert made.details.fastest_pole < 100.0


@pytest.mark.parametrize("name", ["adaptive-uio", "adaptive-uio-printed", "adaptive-uio-full"])
def test_what_is_designed_for_the_aircraft_keeps_its_level_and_its_poles(name):
    made = design(AIRCRAFT, name, pole_bound=30.0)
    assert made.verification.verdict == "proved"
    poles = made.observer.poles.real
    assert poles.min() > -30.0 * (1 + 1e-6) and poles.max() < 0
    A, B = error_matrices(AIRCRAFT, made.observer)
    Z = np.eye(5) if name == "adaptive-uio-printed" else np.eye(5)[4:]
    assert hinf_norm(A, B, Z, np.zeros((len(Z), B.shape[1]))).value <= made.level * (1 + 1e-4)


# ---------------------------------------------------------------- printed gains (test 6)


def least_level(plant, gains, fix):
    """The least level that any P proves for given gains; None when there is none."""
    posed = pose(method("adaptive-uio-printed"), plant, fix=fix)
    by = {u.name: let(u.name, e) for u, e in posed.theorem.prove_with.items() if u.name != "r²"}
    exprs = substitute([i.expr for i in posed.theorem.inequalities], by)
    inequalities = [Inequality(e, i.sense, 0, i.label) for e, i in zip(exprs, posed.theorem.inequalities, strict=True)]
    found = solve(Problem(inequalities, posed.theorem.minimise, {**posed.fixed, **gains}))
    return found.objective**0.5 if found.solved else None


@pytest.mark.parametrize("level", [0.12, 0.06])
def test_the_printed_gains_of_the_aircraft_keep_the_printed_level_and_half_of_it(level):
    plant, gains = PRINTED["civil_aircraft"]
    posed = pose(method("adaptive-uio-printed"), plant)
    values = multipliers(posed, gains, level).values
    assert prove(
        certificate("adaptive-uio-printed", posed.theorem, plant, gains, {**posed.fixed, **values}, level)
    ).sound


@pytest.mark.parametrize("signs", [(1, 1, 1), (1, -1, 1), (1, -1, -1)])
def test_other_signs_of_bd2_do_not_fit_the_printed_gains(signs):
    plant, gains = PRINTED["civil_aircraft"]
    assert least_level(with_d2(plant, *signs), gains, {}) > 40


def test_the_printed_gains_of_the_robot_reach_the_printed_level_whatever_signs_were_lost():
    for a, b, c, d in product((1, -1), repeat=4):
        gains = PRINTED["flexible_joint"][1] | {"F_a": F_ROBOT * [[1, a, b]]}
        assert least_level(with_d2(ROBOT_AS_PRINTED, 1, c, d), gains, {"ε": 40.0}) < 0.48


# ---------------------------------------------------------------- zeros and noise (tests 7 and 10)


@pytest.mark.parametrize(
    ("plant", "signs", "expected"),
    [
        (AIRCRAFT, (1, 1, -1), [-0.03849, -9.60821]),
        (AIRCRAFT, (1, -1, 1), [13.448]),
        (AIRCRAFT, (1, -1, -1), [51.133]),
        (ROBOT, (1, 1, 1), [35.139, -9.406]),
        (ROBOT, (1, 1, -1), [30.818, -31.751]),
        (ROBOT, (1, -1, 1), [-6.207, -59.526]),
        (ROBOT, (1, -1, -1), [-19.533 + 25.218j, -19.533 - 25.218j]),
    ],
)
def test_invariant_zeros(plant, signs, expected):
    zeros = zeros_to_errors(with_d2(plant, *signs))
    for s in expected:  # five digits are tabulated
        assert np.abs(zeros - s).min() <= max(1e-4 * abs(s), 1e-5)


@pytest.mark.parametrize(
    ("sd", "expected"), [(0.1, 0.77114), (0.03, 0.50358), (0.01, 0.20497), (0.003, 0.06329), (0.001, 0.02115)]
)
def test_the_level_with_noise_priced_in(sd, expected):
    noisy = replace(AIRCRAFT, noise=Noise(1e-3, (sd,) * 3))
    assert optimum(noisy, "adaptive-uio-noise", fix={**FULL_ERROR, **NO_LIMIT}) == pytest.approx(expected, abs=1e-4)


def test_the_level_with_noise_is_the_closed_loops_own():
    noisy = replace(AIRCRAFT, noise=Noise(1e-3, (0.01,) * 3))
    made = design(noisy, "adaptive-uio-noise", level=0.2051, fix=FULL_ERROR, pole_bound=None)
    A, B = error_matrices(AIRCRAFT, made.observer)
    M, n = unknown_input_gain(noisy), 4
    L = made.observer.B[:, made.observer.inputs :]
    D = np.vstack([np.hstack([np.zeros((n, 2)), -0.01 * M]), np.zeros((1, 5))])
    norm = hinf_norm(A, np.hstack([B, -0.01 * L]), np.eye(5), D).value
    # The optimum is 0.204973 and no gain has less; the level was asked to 0.2051.
    assert 0.20497 * (1 - 1e-4) <= norm <= 0.2051


@pytest.mark.parametrize(
    ("sd", "ρ", "expected"),
    [
        (0.01, 30.0, 0.05086),
        (0.01, 100.0, 0.04299),
        (0.01, 300.0, 0.04246),
        (0.001, 30.0, 0.04811),
        (0.001, 100.0, 0.02487),
    ],
)
def test_the_robots_level_with_noise_and_a_pole_bound(sd, ρ, expected):
    noisy = replace(ROBOT_AS_PRINTED, noise=Noise(1e-3, (sd,) * 3))
    fix = {**FULL_ERROR, **NO_LIMIT}
    assert optimum(noisy, "adaptive-uio-noise", fix=fix, pole_bound=ρ) == pytest.approx(expected, rel=2e-3)


def test_without_f2_the_augmented_level_is_meaningless():
    assert optimum(ROBOT_AS_PRINTED, "augmented-uio-printed", fix=NO_LIMIT) < 1e-3


def test_the_printed_inequality_is_the_one_of_the_text():
    """Every block of section 2 against numbers written out here, at one arbitrary point."""
    r, θ, ε, Γ = np.random.default_rng(0), 0.333, 40.0, 10.0
    plant, th = ROBOT_AS_PRINTED, pose(method("adaptive-uio-printed"), ROBOT_AS_PRINTED).theorem
    o = error_letters(plant, pose(method("adaptive-uio-printed"), plant).scaling)
    T, S, Φ = (value_of(e, {}) for e in (o.T, o.S, o.Φ))
    Q = r.normal(size=(4, 4))
    P, Y, F, r2 = Q @ Q.T, r.normal(size=(4, 3)), r.normal(size=(1, 3)), 0.7
    A, C, D, M = plant.A, plant.C, plant.F_f, unknown_input_gain(plant)
    J, B2 = np.eye(4) - M @ C, plant.E_w[:, 1:]
    top = P @ J @ A - Y @ C
    full = np.block(
        [
            [top + top.T + (1 + ε * θ**2) * np.eye(4), -Y @ D - (F @ C).T, -P @ M @ D, P @ J @ B2, P @ J],
            [np.zeros((1, 4)), -F @ D - (F @ D).T + 1, np.array([[1 / Γ]]), np.zeros((1, 5))],
            [np.zeros((1, 5)), np.array([[-r2]]), np.zeros((1, 5))],
            [np.zeros((1, 6)), np.array([[-r2]]), np.zeros((1, 4))],
            [np.zeros((4, 7)), -ε * np.eye(4)],
        ]
    )
    full = np.triu(full) + np.triu(full, 1).T
    # P and Y in scaled units: V = x' P x = x_s' (T P T) x_s, and F by the definition of the gains that ship.
    values = {"P": T @ P @ T, "Y": T @ Y @ S, "F": Φ @ F @ S, "r²": r2, "ε": ε, "W": np.eye(1) / Γ, "W_x": np.eye(4)}
    found = value_of(th.inequalities[0].expr, values)
    schur = found[:11, :11] + found[:11, 11:] @ found[11:, :11]  # the last block is -I: weights of the errors
    units = np.diag(np.concatenate([1 / np.diag(T), 1 / np.diag(Φ), np.ones(6)]))
    assert np.allclose(units @ schur @ units, full, rtol=1e-12, atol=1e-12 * np.abs(full).max())


def test_every_proof_of_the_aircraft_is_of_the_gains_that_ship():
    made = design(AIRCRAFT, "adaptive-uio")
    values = {**made.gains, "γ": made.level}
    posed = pose(method("adaptive-uio"), AIRCRAFT)
    stored = {
        k: np.array([float.fromhex(v) for v in d["hex"]]).reshape(d["shape"]) for k, d in made.certificate.data.items()
    }
    for inequality in proof_inequalities(posed.theorem):
        assert np.linalg.eigvalsh(value_of(inequality.positive, {**stored, **values})).min() > 0


# ---------------------------------------------------------------- simulation (test 8)

KINDS = ("bias", "incipient", "loss", "slow sine", "fast sine", "square")


def test_the_robot_is_run_as_far_as_in_the_reference():
    assert np.abs(log_of("robot").x).max(axis=0) == pytest.approx([24.9, 59.2, 24.4, 2.42], rel=3e-3)


def test_a_pole_bound_of_100_gives_the_errors_of_the_reference_although_gains_are_not_unique():
    found = marks(design(ROBOT_AS_PRINTED, "adaptive-uio-printed", pole_bound=100.0).observer, log_of("robot"))
    expected = (2.2e-3, 2.2e-3, 2.3e-3, 2.8e-3, 0.0435, 2.3e-3)
    assert [found[kind].rmse for kind in KINDS] == pytest.approx(expected, rel=0.25)


def test_the_printed_augmented_gains_give_the_errors_of_the_reference():
    found = marks(printed_augmented(), log_of("robot"))
    assert [found[kind].rmse for kind in KINDS] == pytest.approx(
        (1.4e-3, 1.8e-3, 2.9e-2, 1.38e-2, 0.768, 0.144), rel=0.02
    )


def test_the_printed_adaptive_gains_span_the_errors_of_the_reference_over_the_signs_that_were_lost():
    found = [marks(printed_observer("robot", signs), log_of("robot")) for signs in F_SIGNS]
    least = (1.2e-3, 1.5e-3, 1.5e-3, 2.1e-3, 0.030, 1.2e-3)
    largest = (1.8e-3, 2.3e-3, 2.5e-3, 5.5e-3, 0.119, 1.7e-3)
    # Two digits are tabulated: half a unit of the last is 4 % of 1.2e-3.
    assert [min(m[kind].rmse for m in found) for kind in KINDS] == pytest.approx(least, rel=0.04)
    assert [max(m[kind].rmse for m in found) for kind in KINDS] == pytest.approx(largest, rel=0.04)


# ---------------------------------------------------------------- stiff observers (test 9)

STIFF, STEP = printed_observer("aircraft"), 5e-4


def test_the_printed_gains_of_the_aircraft_are_stepped_exactly_by_default():
    assert np.abs(STIFF.poles).max() > 2.5e6
    assert Estimator.build(STIFF, STEP, engine="casadi").scheme == "zoh"


def test_steps_of_any_length_follow_straight_lines_exactly_at_millions_of_radians_per_second():
    log = until(log_of("aircraft"), 6.0)
    long, short = estimates(STIFF, log)[0], estimates(STIFF, finer(log, 8))[0][::8]
    # Nothing but rounding: 2^-52, times the thousands of steps over which the slowest mode keeps it.
    assert np.abs(long - short).max() <= 1e-10 * np.abs(long).max()


def test_the_automatic_choice_changes_where_a_third_of_rk4s_limit_is_passed():
    observer = printed_observer("robot")
    limit = rk4_limit(observer)
    assert limit == pytest.approx(1.05e-4, rel=0.01)
    for step, scheme in ((0.32 * limit, "rk4"), (0.34 * limit, "zoh"), (STEP, "zoh"), (0.05, "zoh")):
        assert Estimator.build(observer, step, engine="casadi").scheme == scheme


def test_a_slow_nonlinear_observer_is_stepped_by_runge_kutta():
    made = design(ROBOT_AS_PRINTED, "adaptive-uio-printed", pole_bound=30.0)
    assert Estimator.build(made.observer, STEP, engine="casadi").scheme == "rk4"


@pytest.mark.parametrize("observer", [printed_observer("robot"), printed_augmented()], ids=["adaptive", "augmented"])
def test_two_integrators_agree(observer):
    log = until(log_of("robot"), 7.0)
    exponential, classical = estimates(observer, log, "zoh")[0], estimates(observer, finer(log, 10), "rk4")[0][::10]
    apart, error = np.abs(exponential - classical), np.abs(exponential - log.f)
    assert apart.max() <= 1e-3 * error.max()
    for kind in ("bias", "incipient"):
        counts = log.where[kind]
        assert apart[counts].max() <= 1e-3 * error[counts].max()


def test_two_integrators_agree_when_each_reads_samples_of_its_own():
    # Here straight lines between samples differ as well: 0.5 ms against 0.05 ms.
    log, fine = robot_log(STEP), robot_log(STEP / 10)
    observer = printed_observer("robot")
    one, two = marks(observer, log, "zoh"), marks(observer, fine, "rk4")
    for kind in KINDS:
        assert one[kind].rmse == pytest.approx(two[kind].rmse, rel=1e-3)


@pytest.mark.parametrize("plant", ["aircraft", "robot"])
def test_runge_kutta_beyond_its_limit_is_refused_and_returns_no_nan(plant):
    observer = printed_observer(plant)
    with pytest.raises(InputError, match="RK4 is unstable at a step") as refused:
        Estimator.build(observer, STEP, scheme="rk4")
    assert "zoh" in str(refused.value)
    log = until(log_of(plant), 2.0)
    assert np.isfinite(estimates(observer, log)[0]).all()
