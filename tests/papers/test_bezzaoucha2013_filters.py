# SPDX-License-Identifier: BSD-3-Clause
"""Bezzaoucha, Marx, Maquin and Ragot 2013, what else reconstructs a lost gain: Kalman filters and additive faults.

The reference rows are those of the table of results that was re-derived for the paper's reactor.  There the estimate
of a filter at a sample holds that sample already; ours is the prediction for it, which for a random walk is that of the
reference one sample earlier.  So estimates are compared one sample later, and the lag itself has a test.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.graph.function import Graph
from faultrecon.methods.registry import method
from faultrecon.methods.scaled_sensors import memberships
from faultrecon.plant.fault import FaultChannel
from faultrecon.plant.plant import OperatingPoint
from faultrecon.plant.polytopic import weights
from faultrecon.plant.sector import Sector
from faultrecon.plant.signals import Channels, Noise, Signals
from faultrecon.simulation.run import watch
from faultrecon.simulation.truth import true_run

SAMPLE, FINE = 0.1, 0.02
FAULTS = {
    "step": lambda t: np.where(t < 60, 0.0, np.where(t < 100, 0.25, 0.5)),
    "ramp": lambda t: np.where(t < 60, 0.0, 0.125 + 0.5 * (t - 60) / 80),
    "sine": lambda t: np.where(t < 60, 0.0, 0.375 + 0.25 * np.sin(2 * np.pi * (t - 60) / 40)),
    "from the start": lambda t: np.full_like(t, 0.4),
}

# ---------------------------------------------------------------- the case study


@cache
def reactor():
    return fr.library("activated_sludge")


def form():
    """The reactor's Takagi-Sugeno model."""
    found = reactor().polytopic
    assert found is not None
    return found


def tuned(state, rate):
    """The reactor with other sizes of what drives it: states, and the fault's rate."""
    louder = tuple(replace(w, size=state) for w in reactor().disturbances)
    return replace(reactor(), disturbances=louder, faults=(replace(reactor().faults[0], rate=rate),))


def dilution(t):
    return 0.08 * np.sin(2 * np.pi * t / 17) + 0.04 * np.sin(2 * np.pi * t / 5.3)


@cache
def plant_run(sample=SAMPLE, off=()):
    """The healthy plant from far away, with inputs as continuous as they are; off: constants that are wrong.

    At SAMPLE inputs are held over each sample, as a filter takes them.
    """
    plant = reactor()
    if off:
        term = plant.nonlinearity
        assert term is not None
        phi = term.phi
        wrong = {name: phi.constants[name] * factor for name, factor in off}
        other = Graph.from_texts(phi.texts, phi.inputs, {**phi.constants, **wrong})
        plant = replace(plant, nonlinearity=replace(term, phi=other), polytopic=None)
    hold = "sample" if sample == SAMPLE else "continuous"
    x0, off_by = (0.1, 1.5), (0.01, -0.8)
    scenario = fr.Scenario(
        140.0, sample, inputs={"dilution": dilution}, noise=False, input_hold=hold, x0=x0, initial_error=off_by
    )
    return true_run(plant, scenario)


def truth(shape, seed=None, **of):
    """The same run with a fouled sensor, which no state feels, and noise on it."""
    run = plant_run(**of)
    f = FAULTS[shape](run.t)[:, None]
    noise = 0.0 if seed is None else 0.02 * np.random.default_rng(seed).normal(size=f.shape)
    return replace(run, f=f, y=(1.0 + f) * run.healthy + noise, noise=noise + 0.0 * f)


def replayed(made, run, hold="linear"):
    """Faults (N,) and states (N, 2)."""
    trace = made.estimator(float(run.t[1]), hold=hold).replay(run.t, run.u, run.y, x=run.x_hat0)
    return trace.fault[:, 0], trace.state


def filtered(made, run):
    """Times and estimates as the reference has them: with the sample of their own time in them."""
    return run.t[:-1], replayed(made, run)[0][1:]


def rmse(made, shape, start=60.0, end=139.8, **of):
    """RMSE of f every 0.02 h by straight lines between samples, over the fault window."""
    at, f_hat = filtered(made, truth(shape, **of))
    t = np.arange(start, end, FINE)
    return float(np.sqrt(np.mean((np.interp(t, at, f_hat) - FAULTS[shape](t)) ** 2)))


@cache
def made(name, state=1e-3, rate=0.02, gate=None):
    plant = reactor() if (state, rate) == (1e-3, 0.02) else tuned(state, rate)
    return fr.design(plant, name, fix={} if gate is None else {"gate": gate})


# ---------------------------------------------------------------- 10: the filters


ROWS = {
    "E1": (("augmented-ekf",), (0.00464, 0.00140, 0.00439)),
    "E2": (("augmented-ekf", 0.02), (0.01578, 0.00652, 0.02910)),
    "E3": (("augmented-ekf", 1e-3, 0.02, 16.0), (0.00433, 0.00037, 0.00161)),
    "E5": (("augmented-ekf", 1e-3, 0.1), (0.00420, 0.00010, 0.00032)),
    "F": (("augmented-ukf",), (0.00464, 0.00140, 0.00439)),
}


@pytest.mark.parametrize("row", ROWS)
def test_the_filters_have_the_known_errors(row):
    arguments, expected = ROWS[row]
    found = [rmse(made(*arguments), shape) for shape in ("step", "ramp", "sine")]
    # 5e-5 is what the reference states for these; inputs are held here over each sample and were not there.
    assert found == pytest.approx(expected, abs=6e-5)


def test_the_extended_filter_passes_as_the_reference_asks_and_the_unscented_one_does_the_same():
    assert rmse(made("augmented-ekf"), "step") == pytest.approx(0.0046, abs=5e-4)
    for shape in ("step", "ramp", "sine"):
        assert rmse(made("augmented-ukf"), shape) == pytest.approx(rmse(made("augmented-ekf"), shape), abs=1e-4)


@pytest.mark.parametrize(("row", "expected"), [("E1", 0.00598), ("E3", 0.00571), ("F", 0.00598)])
def test_in_noise_they_have_the_known_errors(row, expected):
    found = np.mean([rmse(made(*ROWS[row][0]), "step", seed=seed) for seed in (1, 2)])
    assert found == pytest.approx(expected, rel=0.1)  # two seeds there and here


@pytest.mark.parametrize(("name", "factor", "expected"), [("a", 1.02, 0.00978), ("d", 1.02, 0.02958)])
def test_a_wrong_model_biases_the_filter_as_known(name, factor, expected):
    found = np.mean([rmse(made("augmented-ekf"), "step", seed=seed, off=((name, factor),)) for seed in (1, 2)])
    assert found == pytest.approx(expected, rel=0.1)


def test_what_the_filter_shows_at_a_sample_is_one_sample_older():
    run = truth("ramp")
    late = (run.t >= 100.0) & (run.t < 139.0)
    shown = replayed(made("augmented-ekf"), run)[0]
    behind = (FAULTS["ramp"](run.t) - shown)[late].mean() - (FAULTS["ramp"](run.t[:-1]) - shown[1:])[late[:-1]].mean()
    assert behind == pytest.approx(0.5 / 80 * SAMPLE, rel=1e-3)


def test_simulating_and_inverting_is_exact_once_the_start_is_forgotten():
    scenario = fr.Scenario(
        75.0, 0.025, {"fouling": FAULTS["step"]}, {"dilution": dilution}, noise=False, x0=(0.1, 1.5),
        initial_error=(0.01, -0.8), input_hold="sample",
    )  # fmt: skip
    found = fr.simulate(fr.design(reactor(), "simulate-invert"), scenario, hold="left")
    late = found.t >= 60.0
    assert np.sqrt(np.mean((found.f_hat - found.f)[late] ** 2)) < 1e-8


# ---------------------------------------------------------------- logarithms and the gate


def test_the_logarithmic_filter_is_within_a_third_of_the_known_row():
    # How that row was tuned is not known; here it has the tuning of the extended filter, carried over to logarithms.
    expected = (0.00571, 0.00165, 0.00634)
    found = [rmse(made("log-ekf", gate=np.inf), shape) for shape in ("step", "ramp", "sine")]
    assert all(0.67 * one < here <= one for one, here in zip(expected, found, strict=True))


def test_behind_a_gate_it_follows_jumps_like_the_gated_filter():
    for shape, expected in (("step", 0.00433), ("ramp", 0.00037), ("sine", 0.00161)):
        assert rmse(made("log-ekf"), shape) == pytest.approx(expected, abs=5e-5)


def test_a_gate_opens_at_a_jump_and_not_in_noise():
    jumped, still = (rmse(made("augmented-ekf", gate=g), "step", start=60.0, end=61.0) for g in (16.0, None))
    assert jumped < 0.1 * still
    for seed in (1, 2):
        free = [filtered(made("augmented-ekf", gate=g), truth("step", seed=seed))[1][400:595] for g in (16.0, None)]
        assert np.abs(free[0] - free[1]).max() < 1e-9


def test_the_logarithmic_filter_reads_the_gate_from_its_file_and_refuses_one_below_zero():
    assert made("log-ekf").gains["gate"].item() == 16.0 and "gate" not in made("augmented-ekf").gains
    with pytest.raises(fr.InputError, match="the gate is -1"):
        fr.design(reactor(), "log-ekf", fix={"gate": -1})


@pytest.mark.parametrize("reading", [0.0, -0.5, 0.05])
def test_a_sample_at_or_below_zero_or_near_it_corrects_nothing(reading):
    run = truth("step", seed=1)
    y = run.y.copy()
    y[900:905] = reading
    gap = run.y.copy()
    gap[900:905] = np.nan
    estimator = made("log-ekf").estimator()
    held, missing = (estimator.replay(run.t, run.u, one, x=run.x_hat0).fault[:, 0] for one in (y, gap))
    assert np.isfinite(held).all()
    assert np.abs(held[901:906] - held[900]).max() == 0.0  # a random walk holds
    assert np.abs(held - missing).max() < 1e-9


def test_states_and_gains_stay_positive_in_logarithms():
    fault, state = replayed(made("log-ekf"), truth("from the start", seed=1))
    assert state[:, 0].min() > 0 and fault.min() > -1.0


def test_a_sensor_that_may_read_zero_has_no_logarithm():
    box = {**form().box, "biomass": (-0.1, 3.52)}
    plant = replace(reactor(), polytopic=replace(form(), box=box))
    with pytest.raises(fr.Impossible, match=r"turbidity is not always positive.*use augmented-ekf"):
        fr.design(plant, "log-ekf")
    assert fr.design(replace(plant, polytopic=None), "log-ekf")  # without a box, the operating point decides


def test_a_sensor_that_reads_zero_at_rest_shows_nothing_of_its_gain():
    point = OperatingPoint((0.0, 2.5), (0.33,), (0.0,))
    empty = replace(reactor(), operating_point=point, polytopic=None)
    for name in ("augmented-ekf", "augmented-ukf", "log-ekf"):
        with pytest.raises(fr.Impossible, match="turbidity reads zero at the operating point"):
            fr.design(empty, name)


def test_faults_that_add_have_no_logarithm():
    added = replace(reactor(), faults=(replace(reactor().faults[0], effect="additive"),))
    with pytest.raises(fr.Impossible, match=r"no fault of .* multiplies"):
        fr.design(added, "log-ekf")


# ---------------------------------------------------------------- D: additive faults


def rmse_of(made, shape):
    """RMSE of f, x1 and x2 over the fault window."""
    run = truth(shape, sample=FINE)
    (fault, state), late = replayed(made, run), run.t >= 60.0
    errors = np.column_stack([fault - run.f[:, 0], state - run.x])[late]
    return np.sqrt(np.mean(errors**2, axis=0))


def test_with_additive_faults_the_known_row_comes_out_for_drives_of_its_order():
    # The tuning of the reference row is not known; (0.01, 0.01, 0.06) for the states and f h is the round one near it.
    design = made("ts-additive", 0.01, 0.06 / 3.52)
    for shape, expected in (("step", 0.00973), ("ramp", 0.00415), ("sine", 0.01326)):
        assert rmse_of(design, shape)[0] == pytest.approx(expected, rel=0.05)
    assert rmse_of(design, "step")[1] == pytest.approx(0.0082, rel=0.1)


def test_with_the_tuning_of_the_plant_file_it_is_better_than_that_row():
    for shape, row in (("step", 0.00973), ("ramp", 0.00415), ("sine", 0.01326)):
        assert 0.6 * row < rmse_of(made("ts-additive"), shape)[0] < row


def test_what_is_proved_of_it_is_conditional_and_says_so():
    design = made("ts-additive")
    assert design.verification is not None and design.certificate is not None
    assert design.verification.verdict == "assumed"
    assert "no stability proof of the nonlinear error" in design.certificate.scope
    assert "random walk" in design.certificate.scope and "f h - f̂ ĥ" in design.certificate.claim
    assert len(design.gains) == len(Sector.of(reactor()).vertices)


def test_it_serves_the_wide_box_on_which_no_gain_of_the_mean_value_design_does():
    box = {"biomass": (1.0, 3.6), "substrate": (0.04, 0.7), "dilution": (0.21, 0.45)}
    wide = replace(reactor(), polytopic=replace(form(), box=box))
    with pytest.raises(fr.Impossible):
        fr.design(wide, "ts-mean-value")
    found = fr.design(wide, "ts-additive").verification
    assert found is not None and found.sound


def test_a_gap_in_the_faulty_sensor_leaves_the_estimate_where_it_is():
    run = truth("step")
    y = run.y.copy()
    y[900:910] = np.nan
    for design in (made("ts-additive"), made("augmented-ekf"), made("augmented-ukf"), made("log-ekf")):
        trace = design.estimator(SAMPLE).replay(run.t, run.u, y, x=run.x_hat0)
        assert np.isfinite(trace.state).all()
        # Without its sensor ts-additive holds f h, and h moves on by 4 % in the hour.
        assert np.abs(trace.fault[900:925, 0] - 0.25).max() < (0.02 if design.method == "ts-additive" else 0.002)


def test_a_sensor_that_is_missing_beside_one_that_is_not_teaches_nothing():
    plant = with_sensors(TWICE, fouling())
    two, one = fr.design(plant, "augmented-ekf").estimator(), made("augmented-ekf").estimator()
    t, u = SAMPLE * np.arange(200), np.tile(plant.point.u, (200, 1))
    y = np.array(plant.point.y) + 0.02 * np.random.default_rng(4).normal(size=(200, 2))
    silent = y.copy()
    silent[20:, 1] = np.nan
    logs = ((two, y), (two, silent), (one, y[:, :1]))
    # The variance of x1; its start, which is one, is left out of the observer's state.
    whole, through, alone = (float(estimator.replay(t, u, log).end.z[3] + 1.0) for estimator, log in logs)
    # The slopes are those at the estimate, which the first twenty samples made another by a per cent or two.
    assert through == pytest.approx(alone, rel=0.03) and through > 1.1 * whole


# ---------------------------------------------------------------- start-up


STARTS = {
    "B": (("simulate-invert",), 0.0042),
    "C1": (("ts-mean-value",), 0.0018),
    "D": (("ts-additive",), 0.0035),
    "E1": (("augmented-ekf",), 0.0029),
    "E4": (("log-ekf",), 0.0025),
    "F": (("augmented-ukf",), 0.0029),
}


@pytest.mark.parametrize("row", STARTS)
def test_a_fault_from_the_start_is_found_once_the_state_is_seen_and_not_before(row):
    arguments, expected = STARTS[row]
    run = truth("from the start", seed=0)
    error = replayed(made(*arguments), run)[0] - 0.4

    def over(start):
        return np.sqrt(np.mean(error[(run.t >= start) & (run.t < start + 10)] ** 2))

    # One seed there and one here, and how the filters started is not known: a factor of two.
    assert over(30.0) < 2.0 * expected
    assert over(10.0) > 0.02  # until about t = 30 no method is to be relied on


# ---------------------------------------------------------------- several outputs


def with_sensors(C, *faults):
    """The reactor with sensors turbidity and probe, C (2, 2); faults: those that they have."""
    plant, C = reactor(), np.array(C, float)
    y = tuple(float(v) for v in C @ np.array(plant.point.x))
    return replace(
        plant,
        signals=Signals(plant.signals.x, plant.signals.u, Channels.declared(["turbidity [g/l]", "probe [g/l]"])),
        C=C,
        D=np.zeros((2, 1)),
        noise=Noise(0.1, (0.02, 0.02)),
        operating_point=OperatingPoint(plant.point.x, plant.point.u, y),
        faults=tuple(faults),
        polytopic=replace(form(), faults={f.name: (-0.05, 0.65) for f in faults}),
    )


def fouling(sensor="turbidity"):
    return FaultChannel(f"fouling of {sensor}", {sensor: 1.0}, effect="multiplicative", rate=0.02)


TWICE, BOTH = [[1, 0], [1, 0]], [[1, 0], [0, 1]]
SECTORS = ("ts-published", "ts-guaranteed-cost", "ts-mean-value", "ts-additive")


@pytest.mark.parametrize("C", [TWICE, BOTH, [[1, 0], [1, 1]]])
@pytest.mark.parametrize("name", SECTORS)
def test_a_healthy_sensor_beside_the_faulty_one_is_used_and_never_raises_the_level(name, C):
    one, two = fr.design(reactor(), name), fr.design(with_sensors(C, fouling()), name)
    assert one.level is not None and two.level is not None
    assert two.level <= one.level * (1 + 1e-3)
    assert max(np.abs(G[:, 1]).max() for G in two.gains.values() if G.shape[1] == 2) > 1e-3


@pytest.mark.parametrize("name", ["ts-guaranteed-cost", "ts-mean-value", "ts-additive", "log-ekf", "augmented-ukf"])
def test_two_sensors_may_lose_gain_at_once(name):
    plant = with_sensors(BOTH, fouling(), fouling("probe"))
    faults = {"fouling of turbidity": lambda t: 0.3 + 0 * t, "fouling of probe": lambda t: 0.1 + 0 * t}
    found = fr.simulate(fr.design(plant, name), fr.Scenario(40.0, 0.1, faults, noise=False, input_hold="sample"))
    late = found.t >= 35.0
    assert np.abs(found.f_hat[late] - [0.3, 0.1]).max() < 0.02


def test_the_model_in_parallel_says_that_it_leaves_healthy_sensors_unused():
    (said,) = method("simulate-invert").assumptions(with_sensors(TWICE, fouling()))
    assert said.severity == "warning" and "probe stays healthy and corrects nothing" in str(said)
    assert not method("simulate-invert").assumptions(reactor())


def test_a_gain_that_two_sensors_share_is_no_signal_of_one():
    shared = FaultChannel("fouling", {"turbidity": 1.0, "probe": 1.0}, effect="multiplicative", rate=0.02)
    for name in ("ts-additive", "log-ekf"):
        with pytest.raises(fr.Impossible, match="shares its sensor with another, or reaches several"):
            fr.design(with_sensors(TWICE, shared), name)


# ---------------------------------------------------------------- intervals and weights


@pytest.mark.parametrize("name", SECTORS)
def test_an_interval_without_zero_is_warned_of(name):
    away = replace(form(), faults={"fouling": (0.125, 0.625)})
    found = method(name).assumptions(replace(reactor(), polytopic=away))
    assert any("does not contain 0" in f.what and f.severity == "warning" for f in found)
    assert not any("does not contain 0" in f.what for f in method(name).assumptions(reactor()))


@pytest.mark.parametrize("name", ["ts-published", "ts-guaranteed-cost", "ts-additive"])
def test_a_premise_that_leaves_its_bounds_within_the_box_is_warned_of(name):
    for bounds, warned in (({"z2": (5.0, 10.0)}, True), ({"z2": (0.0, 20.0)}, False), ({}, False)):
        found = method(name).assumptions(replace(reactor(), polytopic=replace(form(), bounds=bounds)))
        said = [f for f in found if "leaves its bounds within the box" in f.what]
        assert len(said) == warned and all(f.severity == "warning" and f.evidence["premise"] == "z2" for f in said)


def test_weights_of_premises_stay_at_the_bound_and_those_of_faults_are_nowhere_kept():
    import casadi as ca

    sector = Sector.of(reactor())
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    at = ca.Function("weights", [x, u], [ca.vertcat(*memberships(sector, x, u))])
    inside, beyond = np.array([3.2, 0.2]), np.array([3.2, 0.001])
    assert np.array(at(inside, 0.3)).ravel() == pytest.approx(sector.weights(inside, [0.3])[0], abs=1e-14)
    kept = np.array(at(beyond, 0.3)).ravel()
    assert kept.min() >= 0.0 and kept.sum() == pytest.approx(1.0) and sector.weights(beyond, [0.3]).min() < 0.0
    mu = weights([[0.9]], [form().faults["fouling"]])[0]
    assert mu.min() < 0.0 and mu.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["ts-guaranteed-cost", "ts-mean-value", "ts-additive"])
def test_a_fault_beyond_its_interval_is_followed_and_the_run_says_that_nothing_covers_it(name):
    scenario = fr.Scenario(20.0, FINE, {"fouling": lambda t: np.where(t < 5, 0.0, 0.9)}, noise=False)
    run = fr.simulate(made(name), scenario)
    assert run.f_hat[-1, 0] == pytest.approx(0.9, abs=0.01)
    assert any("fouling" in reason for reason in run.score().outside)


def test_an_estimate_that_leaves_the_box_is_told():
    run = watch(made("ts-additive"), plant_run())
    assert any("biomass" in reason for reason in run.score().outside)
