# SPDX-License-Identifier: BSD-3-Clause
"""Acceptance tests of the sampled proportional-integral observer: runs against the exact plant."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from jia2015_case import (
    LIBRARY,
    PLANT,
    WEIGHTS,
    PlainEuler,
    PlainHeld,
    PlainRk4,
    WithoutEuler,
    WithoutHeld,
    decoupling,
    errors,
    estimator,
    noise,
    reference,
    rms,
    truth,
)

import faultrecon as fr
from faultrecon.methods.euler_pi import EulerPiEuler, EulerPiMinimumNorm
from faultrecon.methods.sampled_limits import practical_bound
from faultrecon.plant.fault import FaultChannel
from faultrecon.runtime.estimator import Estimator
from faultrecon.runtime.filling import Prediction
from faultrecon.simulation.truth import true_run

OBSERVERS = {
    "Euler": (PlainEuler, None),
    "held": (PlainHeld, None),
    "Runge-Kutta": (PlainRk4, PlainHeld),
    "Runge-Kutta, Euler's D₁": (PlainRk4, PlainEuler),
    "Euler, J = I": (PlainEuler, WithoutEuler),
    "Runge-Kutta, J = I": (PlainRk4, WithoutHeld),
}


# ---------------------------------------------------------------- 12 and 13: the truth, and the model as truth


@pytest.mark.parametrize(
    ("shape", "end"),
    [
        ("vary", [0.76499058, -2.16782928, 0.80668475, -2.05917578]),
        ("const", [1.22825627, -0.44573782, 1.23679584, -0.29591981]),
    ],
)
def test_the_truth_ends_where_an_adaptive_integrator_of_order_eight_does(shape, end):
    _, u, x, f = truth(shape, 1.0)
    assert np.abs(x[-1] - end).max() < 1e-8
    if shape == "const":
        run = true_run(PLANT, scenario())
        assert np.abs(run.x - x).max() < 1e-8 and np.array_equal(run.f[:, 0], f) and np.allclose(run.u, u, atol=1e-15)


def scenario(**more) -> fr.Scenario:
    return fr.Scenario.step(
        "actuator",
        size=0.2,
        at=4.0,
        inputs={"voltage": lambda t: 0.3 * np.sin(3 * t)},
        disturbances={"frame": lambda t: np.sin(5 * t), "load": lambda t: 0.3 * np.sin(1.3 * t + 0.5)},
        x0=[0.1, 0.0, -0.1, 0.0],
        input_hold="sample",
        **{"noise": False, "duration": 12.0, **more},
    )


def on_its_own_model(disturbance: float, f: float, start):
    """f̂ - f over 300 samples of Euler's model with the Euler observer."""
    r, T, x = np.random.default_rng(1), 0.01, np.array([0.1, 0.0, -0.1, 0.0])
    t = T * np.arange(301)
    u, w, states = 0.3 * np.sin(3 * t)[:, None], disturbance * r.uniform(-1, 1, 301), []
    for k in range(301):
        states.append(x)
        pull = np.array([0.0, 0.0, 0.0, -3.33 * np.sin(x[2])])
        x = x + T * (PLANT.A @ x + PLANT.B @ (u[k] + f) + pull + PLANT.E_w[:, 0] * w[k])
    run = t, u, np.array(states), np.full(301, f)
    return errors(estimator(PlainEuler), run, start=0.0, x=start)[0]


def test_on_its_own_model_a_constant_fault_is_reconstructed_exactly():
    error = np.abs(on_its_own_model(0.0, 0.2, None))
    assert error[100] == pytest.approx(2.9e-7, rel=0.02) and error[300] < 1e-12


def test_from_a_matched_start_no_decoupled_disturbance_reaches_the_fault_estimate():
    for amplitude, bound in ((1.0, 1e-13), (1000.0, 1e-10)):
        assert np.abs(on_its_own_model(amplitude, 0.0, [0.1, 0.0, -0.1, 0.0])).max() < bound


# ---------------------------------------------------------------- 14 and 15: against T, with the bound beside it

SWEEP = {
    0.02: (1.8745e-2, 2.038e-5, 8.398e-7, 5.206e-2),
    0.01: (9.2508e-3, 2.391e-5, 5.356e-8, 2.427e-2),
    0.005: (4.5952e-3, 1.727e-5, 3.377e-9, 1.196e-2),
    0.0025: (2.2900e-3, 1.002e-5, 2.119e-10, 6.091e-3),
    0.001: (9.1417e-4, 4.344e-6, 5.40e-12, 2.706e-3),
}


def with_the_gains_of(longest: float, kind, T: float):
    """The observer at T with L and F per second of the Euler design at `longest`."""
    one = (PlainHeld if kind is PlainRk4 else kind)(T)
    model = one.model(PLANT, T)
    gains = {**reference(PlainEuler, longest)[2], "T": np.array([[T]]), "Φ₁": model, "H": one.decoupling(PLANT, model)}
    return gains, Estimator.build(kind(T).observer(PLANT, gains), T, prediction=Prediction(PLANT.C, PLANT.D))


@pytest.fixture(scope="module")
def sweep():
    found = {}
    for T in SWEEP:
        run = truth("const", 0.0, T, 0.0)
        found[T] = [
            np.abs(errors(with_the_gains_of(0.02, kind, T)[1], run, start=8.0)[0]).max()
            for kind in (PlainEuler, PlainHeld, PlainRk4)
        ]
    return found


def test_the_error_against_the_sample_time_for_three_predictions(sweep):
    for T, (euler, held, rk4, _) in SWEEP.items():
        assert sweep[T][:2] == pytest.approx([euler, held], rel=0.01)
        # At 0.001 s the truth's own error of 1e-12 shows.
        assert sweep[T][2] == pytest.approx(rk4, rel=0.01 if T > 0.002 else 0.6)


def test_the_order_of_convergence_is_one_for_euler_and_four_for_runge_kutta(sweep):
    assert np.log10(sweep[0.01][0] / sweep[0.001][0]) == pytest.approx(1.0, abs=0.05)
    assert np.log2(sweep[0.01][2] / sweep[0.0025][2]) / 2 == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize("T", SWEEP)
def test_the_practical_bound_holds_and_is_not_far_from_the_truth(sweep, T):
    t, u, x, f = truth("const", 0.0, T, 0.0)
    pull = np.column_stack([np.zeros((len(x), 3)), -3.33 * np.sin(x[:, 2])])
    model = x + T * (x @ PLANT.A.T + (u + f[:, None]) @ PLANT.B.T + pull)
    off = ((x[1:] - model[:-1]) / T)[t[:-1] >= 4.0]  # what Euler's model misses per second, in the fault's time
    reach = np.abs(off).max(axis=0)
    reach = reach * np.sqrt(((off / reach) ** 2).sum(axis=1).max())
    bound = practical_bound(PlainEuler(T), PLANT, with_the_gains_of(0.02, PlainEuler, T)[0], reach, (2, 3, 4, 5, 6, 7))
    assert sweep[T][0] < bound.value < 3.1 * sweep[T][0]
    # The tabulated bounds grow looser with shorter T, where they were found less exactly; these are no larger.
    assert bound.value < 1.001 * SWEEP[T][3] and (T < 0.01 or bound.value == pytest.approx(SWEEP[T][3], rel=1e-3))


# ---------------------------------------------------------------- 16 to 18: the tables

CLEAN = {
    "Euler": (4.8009e-3, 1.47184e-2, 1.9741e-2, 2.6967e-2),
    "held": (4.9693e-4, 1.08374e-2, 1.5057e-2, 2.0218e-2),
    "Runge-Kutta": (5.1160e-4, 1.08264e-2, 1.5500e-2, 2.0577e-2),
    "Euler, J = I": (1.70049e-2, 2.00799e-2, 3.0938e-2, 4.1295e-2),
    "Runge-Kutta, J = I": (1.66805e-2, 1.85407e-2, 2.5690e-2, 3.3332e-2),
}
AMPLITUDES = (0.0, 1.0, 3.0, 10.0)
NOISY = {
    ("Euler", "const"): (0.01081, 0.01084, 0.01109, 0.01445),
    ("held", "const"): (0.00972, 0.00972, 0.00972, 0.00973),
    ("Runge-Kutta", "const"): (0.00972, 0.00972, 0.00972, 0.00973),
    ("Runge-Kutta, Euler's D₁", "const"): (0.00969, 0.01068, 0.01657, 0.04584),
    ("Euler, J = I", "const"): (0.00930, 0.01888, 0.05027, 0.16654),
    ("Runge-Kutta, J = I", "const"): (0.00833, 0.01859, 0.05054, 0.16599),
    ("Euler", "vary"): (0.01778, 0.01776, 0.01785, 0.01756),
    ("held", "vary"): (0.01468, 0.01468, 0.01469, 0.01472),
    ("Runge-Kutta", "vary"): (0.01468, 0.01468, 0.01469, 0.01472),
    ("Runge-Kutta, Euler's D₁", "vary"): (0.01517, 0.01605, 0.02081, 0.04808),
    ("Euler, J = I", "vary"): (0.01454, 0.02177, 0.05139, 0.16585),
    ("Runge-Kutta, J = I", "vary"): (0.01219, 0.02035, 0.05099, 0.16616),
}


@pytest.mark.parametrize("name", CLEAN)
def test_clean_runs_give_the_errors_of_the_table(name):
    found = [errors(estimator(*OBSERVERS[name]), truth(shape, 1.0)) for shape in ("const", "vary")]
    measured = [rms(e[0]) for e in found] + [rms(e[1][:, 3]) for e in found]
    assert measured == pytest.approx(CLEAN[name], rel=0.01)


def noisy(name: str, shape: str) -> list[float]:
    est = estimator(*OBSERVERS[name])
    return [np.mean([rms(errors(est, truth(shape, a), noise(s))[0]) for s in range(4)]) for a in AMPLITUDES]


@pytest.mark.parametrize(("name", "shape"), NOISY)
def test_noisy_runs_give_the_errors_of_the_table(name, shape):
    assert noisy(name, shape) == pytest.approx(NOISY[name, shape], rel=0.03)


def test_what_is_decoupled_does_not_matter_and_what_is_not_does():
    for shape in ("const", "vary"):
        quiet, *_, loud = noisy("held", shape)
        assert loud / quiet <= 1.01
        quiet, *_, loud = noisy("Runge-Kutta, J = I", shape)
        assert loud / quiet >= 10


# ---------------------------------------------------------------- 21, and what users do


@pytest.mark.parametrize("sensor", ["enc_motor", "enc_link"])
def test_an_actuator_and_a_sensor_fault_are_reconstructed_together(sensor):
    plant = replace(PLANT, faults=(*PLANT.faults, FaultChannel("bias", {sensor: 1.0})))
    design = fr.design(plant, "euler-pi", fix={**WEIGHTS, "α": 0.5})
    t, u, x, f = truth("const", 1.0)
    bias = np.where(t >= 2.0, 0.1, 0.0)
    y = x @ PLANT.C.T + noise(0) + bias[:, None] * plant.F_f[:, 1]
    trace, late = design.estimator().replay(t, u, y), t >= 8.0
    assert rms((trace.fault[:, 1] - bias)[late]) < 0.02
    assert rms((trace.fault[:, 0] - f)[late]) < 0.04
    assert np.abs(trace.corrected[late] - (x @ PLANT.C.T)[late]).max() < 0.1


def shown(name: str, shape: str, a: float) -> float:
    """The error of the fault in noise with what a method ships, mean of four seeds."""
    est = shipped(name)
    return float(np.mean([rms(errors(est, truth(shape, a), noise(s))[0]) for s in range(4)]))


@cache
def shipped(name: str) -> Estimator:
    return fr.design(LIBRARY, name).estimator()


def test_the_shipped_design_does_as_well_as_the_reference_design():
    for name in ("euler-pi", "euler-pi-rk4"):
        for shape, best in (("const", 0.0097), ("vary", 0.0147)):
            assert shown(name, shape, 1.0) < 1.2 * best


@pytest.mark.parametrize("name", ["augmented-ekf", "augmented-ukf"])
def test_a_kalman_filter_wins_while_what_disturbs_is_moderate_and_the_observer_beyond(name):
    for shape in ("const", "vary"):
        for a in (1.0, 3.0):
            assert shown(name, shape, a) < NOISY["held", shape][AMPLITUDES.index(a)]
        assert shown(name, shape, 10.0) > 1.3 * shown("euler-pi", shape, 10.0)


@pytest.mark.parametrize("silent", [[0], [1], [2], [0, 1, 2]])
def test_a_gap_is_predicted_through_without_losing_the_fault(silent):
    t, u, x, _ = truth("const", 1.0)
    y = x @ PLANT.C.T
    gappy = y.copy()
    gappy[800:820, silent] = np.nan
    est = fr.design(PLANT, "euler-pi").estimator()
    whole, through = est.replay(t, u, y), est.replay(t, u, gappy)
    away = np.abs(through.fault - whole.fault)[:, 0]
    assert not away[:800].any() and away[800:820].max() < 0.2 and away[1000:].max() < 0.01
    assert np.isfinite(through.corrected).all()


def test_rows_that_never_came_cost_no_more_than_rows_without_values():
    t, u, x, f = truth("const", 1.0)
    y, kept = x @ PLANT.C.T, np.r_[0:800, 805:1201]
    trace = fr.design(PLANT, "euler-pi").estimator().replay(t[kept], u[kept], y[kept])
    error = np.abs(trace.fault[:, 0] - f[kept])[800:]
    assert error.max() < 0.2 and error[200:].max() < 0.01 and trace.end.gaps == 5


def test_simulate_runs_a_sampled_observer_with_its_own_sample_time():
    slower = fr.design(PLANT, "euler-pi", fix={"T": 0.02})
    assert slower.observer.sample_time == 0.02 and slower.verification.verdict == "proved"
    with pytest.raises(fr.InputError, match=r"made for 0\.02 s"):
        fr.simulate(slower, scenario())
    run = fr.simulate(slower, scenario(sample_time=0.02, duration=8.0, noise=True))
    assert run.score()["actuator"].nrmse < 0.4


def test_two_disturbances_are_decoupled_where_there_are_sensors_for_them():
    plant = decoupling({"theta_m": 0.2, "theta_l": 1.0})
    assert fr.design(plant, "euler-pi").verification.verdict == "proved"


def test_the_ramp_model_follows_a_growing_fault_with_less_lag():
    weights = {**WEIGHTS, "α": 1.0}
    ramp = fr.design(PLANT, "euler-pi-ramp", fix=weights)
    assert ramp.verification.verdict == "proved"
    steady, growing = (fr.design(PLANT, name, fix=weights).estimator() for name in ("euler-pi", "euler-pi-ramp"))
    lag = [rms(errors(one, truth("vary", 1.0))[0]) for one in (steady, growing)]
    assert lag[1] < 0.75 * lag[0]
    noisy = [rms(errors(one, truth("vary", 1.0), noise(0))[0]) for one in (steady, growing)]
    assert noisy[1] < 0.0125 < noisy[0]


def test_with_one_sample_of_noise_per_step_the_pseudo_inverse_is_as_quiet_as_the_projector():
    class Whole(EulerPiMinimumNorm):
        model, model_identities = EulerPiEuler.model, EulerPiEuler.model_identities

    quiet, other = (rms(errors(estimator(kind), truth("const", 1.0), noise(0))[0]) for kind in (PlainEuler, Whole))
    assert other == pytest.approx(quiet, rel=0.01)
