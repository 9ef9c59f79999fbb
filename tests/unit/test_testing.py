# SPDX-License-Identifier: BSD-3-Clause
"""Good methods pass every check, and a method with one thing wrong fails the check that is about it, in its words."""

import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from faultrecon.advise.trials import reordered
from faultrecon.finding import Finding
from faultrecon.graph.function import Graph
from faultrecon.io.library import read_library
from faultrecon.lmi.expr import I, given, let
from faultrecon.methods.base import Paper
from faultrecon.methods.lipschitz_hinf import LipschitzHinf
from faultrecon.methods.open_loop import OpenLoop
from faultrecon.methods.registry import all_methods, list_methods
from faultrecon.plant.lipschitz import KnownTerm
from faultrecon.testing import Trial, all_checks, check_method, trial_plants

SPRING, PENDULUM, *_ = trial_plants()
CHECKS = {check.__name__: check for check in all_checks()}


@pytest.fixture(scope="module", params=list_methods(variants=True))
def good(request):
    return all_methods()[request.param]


def test_methods_of_the_package_pass_where_their_assumptions_are_met(good):
    fit = [p for p in trial_plants() if all(f.severity != "fatal" for f in good.assumptions(p))]
    if fit:
        assert len(check_method(good, fit)) == len(fit) * len(CHECKS)
    else:
        with pytest.raises(AssertionError, match="nothing was tried"):
            check_method(good, trial_plants())


def test_lipschitz_hinf_passes_on_every_trial_plant_by_name_class_and_value():
    for tried in ("lipschitz-hinf", LipschitzHinf, LipschitzHinf()):
        assert check_method(tried, [SPRING]) == [f"{check} on spring" for check in CHECKS]
    assert {line.partition(" on ")[2] for line in check_method("lipschitz-hinf")} == {"spring", "pendulum"}


def test_a_plant_with_a_known_term_is_reordered_with_its_term():
    g = Graph.from_texts(["-position_a"], {"y": PENDULUM.signals.y.names, "u": ["force"], "t": ["t"]})
    plant = replace(PENDULUM, known=KnownTerm(np.array([[0.0], [1.0]]), g))
    assert check_method("lipschitz-hinf", [plant])


def test_a_reordered_plant_keeps_units_ranges_and_limits_of_its_sensors():
    y = replace(PENDULUM.signals.y, ranges=(0.5, 0.25), limits=((-1.0, 1.0), (-np.inf, 3.0)))
    plant = replace(PENDULUM, signals=replace(PENDULUM.signals, y=y))
    moved = reordered(plant, [1, 0])
    assert moved.signals.y.limited() == y.limited() and moved.signals.y.ranges == (0.25, 0.5)
    assert reordered(moved, [1, 0]).digest() == plant.digest()


def test_a_plant_of_a_paper_serves():
    assert check_method("lipschitz-hinf", [read_library("lipschitz_polynomial")])


def test_when_no_plant_fits_that_is_a_failure_with_the_reasons():
    with pytest.raises(AssertionError, match=r"nothing was tried: .*the plant is sampled"):
        check_method("lipschitz-hinf", [replace(SPRING, sample_time=0.1)])


def test_the_battery_is_listed_and_every_check_says_what_it_is_about():
    assert len(CHECKS) == len(all_checks()) == 16
    assert all(name.startswith("check_") and check.__doc__ for name, check in CHECKS.items())


def test_trying_a_method_leaves_no_trace_of_it():
    before = list_methods(variants=True)
    CHECKS["check_name_and_paper"](Trial(Mine(), SPRING))
    assert list_methods(variants=True) == before


# ---------------------------------------------------------------- one thing wrong at a time


class Mine(LipschitzHinf):
    """Nothing wrong yet."""

    name = "mine"
    reproductions = ()


class Shouting(Mine):
    name = "My Method!"


class Unsaid(Mine):
    summary = "two\nlines"


class Uncitable(Mine):
    paper = Paper("", "", 2030, "", "")


class Orphan(Mine):
    variant_of = "a-method-nobody-knows"


class Raising(Mine):
    def assumptions(self, plant):
        return [Finding("none")] if len(plant.faults) == 0 else super().assumptions(plant) + [plant.faults[1]][:0]


class Moody(Mine):
    calls = 0

    def assumptions(self, plant):
        type(self).calls += 1
        return [*super().assumptions(plant), Finding(f"call {self.calls}", severity="note")]


class Chatty(Mine):
    def assumptions(self, plant):
        return ["the plant is ugly"]


class Theorems(Mine):
    """A theorem with one part changed."""

    def theorem(self, plant, scaling):
        return self.changed(super().theorem(plant, scaling), plant)


class Wide(Theorems):
    def changed(self, th, plant):
        return replace(th, minimise=I(2))


class Unlabelled(Theorems):
    def changed(self, th, plant):
        return replace(th, inequalities=[i.tagged("same") for i in th.inequalities])


class Speechless(Theorems):
    def changed(self, th, plant):
        return replace(th, scope="")


class Misfit(Theorems):
    def changed(self, th, plant):
        return replace(th, gains={letter: given("M", np.zeros((5, 5))) for letter in th.gains})


class Crowded(Theorems):
    def changed(self, th, plant):
        return replace(th, readout=given("two rows", np.zeros((len(plant.faults) + 1, plant.n))))


class Curly(Theorems):
    def changed(self, th, plant):
        first, *others = th.inequalities
        named = let("P}", first.expr)
        return replace(th, inequalities=[replace(first, expr=named), *others])


class Partial(Mine):
    """Disturbances count only where the first sensor is called position_a."""

    def theorem(self, plant, scaling):
        if plant.signals.y.names[0] != "position_a":
            plant = replace(plant, disturbances=tuple(replace(d, size=2 * d.size) for d in plant.disturbances))
        return super().theorem(plant, scaling)


class Restless(Mine):
    calls = 0

    def theorem(self, plant, scaling):
        type(self).calls += 1
        changed = replace(scaling, state=scaling.state + self.calls % 3)
        return super().theorem(plant, changed)


class Silent(Mine):
    """No certificate, and no baseline either."""

    baseline = False

    def gains_without_proof(self, plant):
        return {"L": np.ones((plant.n, plant.p - 1)), "K1": np.zeros((1, plant.p - 1))}


class Drifting(Theorems):
    """A theorem that is another one each time it is stated."""

    calls = 0

    def changed(self, th, plant):
        type(self).calls += 1
        return replace(th, claim=f"{th.claim}, stated {self.calls} times")


class Toothless(Theorems):
    """Only β > 0 is left to prove: any level and any P will do."""

    def changed(self, th, plant):
        return replace(th, inequalities=[i for i in th.inequalities if i.label == "β > 0"])


class Observers(Mine):
    """An observer with one part changed."""

    def observer(self, plant, gains):
        return self.changed(super().observer(plant, gains), gains)


class Random(Observers):
    def changed(self, o, gains):
        return replace(o, Cf=o.Cf + np.random.default_rng().normal(size=o.Cf.shape))


class Greedy(Observers):
    def changed(self, o, gains):
        gains["L"][:] *= 2.0
        return o


class Elsewhere(Observers):
    def changed(self, o, gains):
        return replace(o, x0=o.x0 + 1.0)


class Untaken(Observers):
    def changed(self, o, gains):
        return replace(o, F=0.0 * o.F)


class Unbounded(Observers):
    def changed(self, o, gains):
        return replace(o, Dx=o.Dx + np.inf)


class Growing(Observers):
    def changed(self, o, gains):
        return replace(o, A=-o.A)


class Halving(Observers):
    def changed(self, o, gains):
        return replace(o, Cf=0.5 * o.Cf, Df=0.5 * o.Df)


class Broken(Observers):
    def changed(self, o, gains):
        raise KeyError("K2")


SABOTAGE = [
    (Shouting, "check_name_and_paper", "lower-case words"),
    (Unsaid, "check_name_and_paper", "not one line of text"),
    (Uncitable, "check_name_and_paper", "cannot be cited"),
    (Orphan, "check_name_and_paper", "variant of 'a-method-nobody-knows'"),
    (Raising, "check_assumptions", "the assumptions raise IndexError"),
    (Moody, "check_assumptions", "for the plant the assumptions differ from call to call"),
    (Chatty, "check_assumptions", "not a list of findings"),
    (Wide, "check_theorem_shapes", r"minimises a \(2, 2\) matrix"),
    (Unlabelled, "check_theorem_shapes", "not distinct names"),
    (Speechless, "check_theorem_shapes", "lacks a claim or a scope"),
    (Misfit, "check_theorem_shapes", r"the gain L .* has a formula of \(5, 5\)"),
    (Crowded, "check_theorem_shapes", "reads 2 faults out of the error, the plant has 1"),
    (Curly, "check_theorem_is_typeset", "braces .* do not match"),
    (Partial, "check_level_ignores_sensor_order", "with sensors reordered"),
    (Restless, "check_design_is_deterministic", "differs"),
    (Drifting, "check_certificate_holds", "does not state its theorem"),
    (Random, "check_observer", "differs in Cf from call to call"),
    (Greedy, "check_observer", "changes the gains"),
    (Elsewhere, "check_observer", "about another x0"),
    (Untaken, "check_observer", "another matrix than F_f"),
    (Unbounded, "check_observer", "a Dx that is not finite"),
    (Growing, "check_poles_are_stable", "do not decay"),
    (Halving, "check_constant_fault_arrives", r"with the gain \[\[0.5\]\]"),
    (Broken, "check_observer", "check_observer: KeyError: 'K2'"),
]


@pytest.mark.parametrize(("kind", "check", "words"), SABOTAGE, ids=lambda v: getattr(v, "__name__", str(v)[:20]))
def test_a_method_with_one_thing_wrong_fails_the_check_about_it(kind, check, words):
    trial = Trial(kind(), SPRING)
    if kind in (Greedy, Random, Elsewhere, Untaken, Unbounded, Growing, Halving, Broken):
        # These ship the gains of the good method: what is wrong is the observer alone.
        trial.__dict__["design"] = _with_method(Trial(Mine(), SPRING).design, kind.name)
    with pytest.raises(AssertionError, match=words):
        CHECKS[check](trial)


def _with_method(design, name):
    return replace(design, method=name, gains={k: v.copy() for k, v in design.gains.items()})


def test_a_design_without_certificate_is_for_baselines_alone():
    trial = Trial(Silent(), SPRING)
    design = Trial(Mine(), SPRING).design
    trial.__dict__["design"] = replace(design, certificate=None, level=None)
    with pytest.raises(AssertionError, match="no baseline and its design carries no certificate"):
        CHECKS["check_certificate_holds"](trial)


def test_a_theorem_that_proves_nothing_is_found_by_its_false_certificates():
    from faultrecon.synthesis.certify import certificate
    from faultrecon.synthesis.levels import scale

    good = Trial(Mine(), SPRING).design
    trial = Trial(Toothless(), SPRING)
    theorem = trial.method.theorem(SPRING, scale(SPRING))
    values = {"β": np.eye(1)}
    made = certificate("mine", theorem, SPRING, good.gains, values, good.level)
    trial.__dict__["design"] = replace(good, certificate=made)
    with pytest.raises(AssertionError, match="still believed with a level 10 % below the optimum"):
        CHECKS["check_mutated_certificate_is_refuted"](trial)


class Sloppy:
    """An estimator, until one of its functions is replaced."""

    def __init__(self, good):
        self.good, self.calls = good, 0

    def init(self):
        return self.good.init()

    def step(self, state, t, u, y):
        return self.good.step(state, t, u, y)

    def replay(self, t, u, y):
        return self.good.replay(t, u, y)


PARTS = ("fault", "state", "corrected", "ok")


def changed(result, **parts):
    """An estimate or a trace with some of its parts replaced."""
    return SimpleNamespace(**{part: getattr(result, part).copy() for part in PARTS} | parts)


def sabotaged(part, change):
    """A trial whose estimator has one function replaced."""
    trial = Trial(Mine(), SPRING)
    trial.__dict__["estimator"] = type("Changed", (Sloppy,), {part: change})(trial.estimator)
    return trial


def writes_into_its_input(self, state, t, u, y):
    y[0] += 1.0
    return self.good.step(state, t, u, y)


def counts_its_calls(self, state, t, u, y):
    new, estimate = self.good.step(state, t, u, y)
    self.calls += 1
    return new, changed(estimate, fault=estimate.fault + self.calls)


def replays_in_other_bits(self, t, u, y):
    trace = self.good.replay(t, u, y)
    return changed(trace, state=trace.state * (1 + 4e-16))


def flags_nothing(self, t, u, y):
    trace = self.good.replay(t, u, y)
    return changed(trace, ok=np.ones_like(trace.ok))


def spreads_gaps(self, t, u, y):
    trace = self.good.replay(t, u, y)
    return changed(trace, state=np.where(np.isfinite(y).all(axis=1)[:, None], trace.state, np.nan))


def never_recovers(self, t, u, y):
    fault = self.good.replay(t, u, y).fault.copy()
    fault[-3:] = np.nan
    return changed(self.good.replay(t, u, y), fault=fault)


@pytest.mark.parametrize(
    ("part", "change", "check", "words"),
    [
        ("step", writes_into_its_input, "check_steps_are_pure", "changes what it is given"),
        ("step", counts_its_calls, "check_steps_are_pure", "two steps of mine from one state differ"),
        ("replay", replays_in_other_bits, "check_replay_is_step_by_step", "differs from its step in state"),
        ("replay", flags_nothing, "check_gaps_are_flagged", "does not flag exactly"),
        ("replay", spreads_gaps, "check_gaps_are_flagged", "a gap reaches the state estimate"),
        ("replay", never_recovers, "check_gaps_are_flagged", "a gap outlasts its cause"),
    ],
)
def test_an_estimator_with_one_thing_wrong_fails_the_check_about_it(part, change, check, words):
    with pytest.raises(AssertionError, match=words):
        CHECKS[check](sabotaged(part, change))


def test_a_method_that_is_another_one_when_read_back_fails_the_check_about_files():
    with pytest.raises(AssertionError, match=r"check_files_come_back: InputError: .*does not state the theorem"):
        CHECKS["check_files_come_back"](Trial(Drifting(), SPRING))


def test_a_weaker_certificate_that_is_taken_for_the_theorem_is_found(monkeypatch):
    monkeypatch.setattr("faultrecon.synthesis.certify.conforms", lambda made, theorem: True)
    with pytest.raises(AssertionError, match=r"accepts a certificate without the step '\(3.1\)'"):
        CHECKS["check_weaker_statement_is_not_the_theorem"](Trial(Mine(), SPRING))


def test_every_check_can_fail():
    sabotage = {check for _, check, _ in SABOTAGE}
    others = {"check_mutated_certificate_is_refuted", "check_weaker_statement_is_not_the_theorem"}
    runtime = {
        "check_steps_are_pure",
        "check_replay_is_step_by_step",
        "check_gaps_are_flagged",
        "check_files_come_back",
    }
    assert sabotage | others | runtime == set(CHECKS)


def test_open_loop_is_tried_where_its_plant_forgets_and_refused_where_it_does_not():
    assert check_method(OpenLoop(), [SPRING])
    heavy = replace(SPRING, A=np.array([[0.0, 1.0], [-10.0, 0.0]]))
    with pytest.raises(AssertionError, match="the open loop forgets nothing"):
        check_method(OpenLoop(), [heavy])


def test_the_checks_need_no_test_runner():
    code = (
        "import sys, faultrecon.testing; print({'pytest', 'hypothesis', 'scipy.optimize', 'casadi'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
