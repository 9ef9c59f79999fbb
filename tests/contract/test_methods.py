# SPDX-License-Identifier: BSD-3-Clause
"""What every method owes its users, on every library plant whose assumptions it meets."""

from functools import cache

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.io.library import library_names
from faultrecon.methods.base import Unproved
from faultrecon.methods.registry import all_methods, method
from faultrecon.synthesis.levels import scale

METHODS = sorted(all_methods())
PLANTS = sorted(library_names())
plant = cache(fr.library)


@cache
def made(name: str, library: str, attempt: int) -> fr.Design | fr.FaultreconError:
    """A design, or why there is none; each attempt is made anew."""
    try:
        return fr.design(plant(library), name)
    except fr.FaultreconError as error:
        return error


@cache
def designs(name: str) -> dict[str, fr.Design]:
    """The designs of a method by library plant, where it has one: at least one, or nothing was tested."""
    found = {library: d for library in PLANTS if isinstance(d := made(name, library, 1), fr.Design)}
    assert found, f"{name} has a design for no plant of the library"
    return found


@cache
def log(library: str):
    """A short synthetic log around the operating point: t (40,), u (40, m), y (40, p), regular samples."""
    p, r = plant(library), np.random.default_rng(7)
    step = 0.01 if p.noise is None else p.noise.hold
    sizes = np.ones(p.p) if p.noise is None else np.array(p.noise.sd)
    y = np.array(p.point.y) + 3.0 * sizes * r.normal(size=(40, p.p))
    u = np.array(p.point.u) + 0.1 * r.normal(size=(40, len(p.signals.u)))
    return step, step * np.arange(40), u, y


@cache
def estimators(name: str) -> dict[str, fr.Estimator]:
    return {library: d.estimator(log(library)[0]) for library, d in designs(name).items()}


def same(a, b) -> bool:
    return np.asarray(a).tobytes() == np.asarray(b).tobytes()


# ---------------------------------------------------------------- what it says about itself


@pytest.mark.parametrize("name", METHODS)
def test_a_method_says_its_name_its_purpose_and_its_source(name):
    m = method(name)
    assert m.name == name and name == name.lower() and " " not in name
    assert m.summary.strip() and m.summary[0].islower() | m.summary[0].isupper() and not m.summary.endswith(".")
    assert m.paper.key and m.paper.authors and m.paper.title and 1900 < m.paper.year < 2100
    assert m.paper.authors in fr.cite(name) and str(m.paper.year) in fr.cite(name)
    assert m.variant_of is None or m.variant_of in METHODS
    assert (name in fr.list_methods()) == (m.variant_of is None)


def test_every_library_plant_has_a_method():
    assert {library for name in METHODS for library in designs(name)} == {*PLANTS}


# ---------------------------------------------------------------- purity


@pytest.mark.parametrize("library", PLANTS)
@pytest.mark.parametrize("name", METHODS)
def test_asking_for_assumptions_changes_nothing_and_answers_the_same_twice(name, library):
    p, m = plant(library), method(name)
    before = p.digest()
    first, second = m.assumptions(p), m.assumptions(p)
    assert [f.as_dict() for f in first] == [f.as_dict() for f in second] and p.digest() == before
    assert all(f.what for f in first)


@pytest.mark.parametrize("library", PLANTS)
@pytest.mark.parametrize("name", METHODS)
def test_two_designs_of_one_plant_are_equal_to_the_last_bit(name, library):
    before = plant(library).digest()
    first, second = (made(name, library, attempt) for attempt in (1, 2))
    assert plant(library).digest() == before
    if not (isinstance(first, fr.Design) and isinstance(second, fr.Design)):
        assert str(first) == str(second)
        return
    assert (first.optimum, first.level, first.floor) == (second.optimum, second.level, second.floor)
    assert first.gains.keys() == second.gains.keys()
    assert all(same(first.gains[k], second.gains[k]) for k in first.gains)
    assert first.plant.digest() == before


@pytest.mark.parametrize("library", PLANTS)
@pytest.mark.parametrize("name", METHODS)
def test_what_an_assumption_forbids_is_the_reason_there_is_no_design(name, library):
    fatal = [f for f in method(name).assumptions(plant(library)) if f.severity == "fatal"]
    outcome = made(name, library, 1)
    if fatal:
        assert isinstance(outcome, fr.Impossible) and str(fatal[0]) in str(outcome)
    elif isinstance(outcome, fr.FaultreconError):
        assert name in str(outcome) and outcome.finding.remedies
        # A variant is kept for reference and may defeat the solver; a method has an answer for the whole library.
        assert isinstance(outcome, fr.Impossible) or method(name).variant_of is not None


@pytest.mark.parametrize("name", METHODS)
def test_a_design_is_certified_and_states_the_theorem_of_its_method(name):
    for library, design in designs(name).items():
        if isinstance(method(name), Unproved):
            assert method(name).baseline and design.certificate is None and design.level is None
            continue
        assert design.certificate is not None and design.verification is not None, library
        # A Lipschitz constant that somebody vouches for leaves the whole as strong as that word.
        premises = [s.verdict for s in design.certificate.steps if s.kind == "premise"]
        weakest = next((v for v in ("assumed", "checked") if v in premises), "proved")
        assert design.verification.verdict == weakest, library
        assert design.certificate.theorem == method(name).theorem(design.plant, scale(design.plant)).number
        assert design.floor is None or design.level is None or design.floor <= design.level, library


# ---------------------------------------------------------------- the estimator


@pytest.mark.parametrize("name", METHODS)
def test_replaying_a_log_gives_the_bits_of_stepping_through_it(name):
    for library, est in estimators(name).items():
        _, t, u, y = log(library)
        trace, state = est.replay(t, u, y), est.init()
        for k in range(len(t)):
            state, estimate = est.step(state, t[k], u[k], y[k])
            for part in ("fault", "state", "corrected", "ok"):
                assert same(getattr(estimate, part), getattr(trace, part)[k]), (library, part, k)
        assert np.isfinite(trace.fault).all() and np.isfinite(trace.corrected).all() and trace.ok.all(), library


@pytest.mark.parametrize("name", METHODS)
def test_stepping_changes_neither_the_state_nor_the_sample_it_is_given(name):
    for library, est in estimators(name).items():
        _, t, u, y = log(library)
        state, _ = est.step(est.init(), t[0], u[0], y[0])
        kept = [v.copy() for v in (u[1], y[1], state.z, state.v, state.missing)]
        first, second = est.step(state, t[1], u[1], y[1])[1], est.step(state, t[1], u[1], y[1])[1]
        assert same(first.fault, second.fault) and same(first.state, second.state), library
        now = (u[1], y[1], state.z, state.v, state.missing)
        assert all(same(a, b) for a, b in zip(kept, now, strict=True)) and state.samples == 1, library


@pytest.mark.parametrize("name", METHODS)
def test_a_channel_that_falls_silent_is_flagged_alone_and_the_rest_goes_on(name):
    for library, est in estimators(name).items():
        _, t, u, y = log(library)
        for channel in range(y.shape[1]):
            gappy = y.copy()
            gappy[10:15, channel] = np.nan
            trace, silent = est.replay(t, u, gappy), np.isnan(gappy)
            assert np.array_equal(trace.ok, ~silent), (library, channel)
            assert np.isfinite(trace.state).all(), (library, channel)
            assert np.isfinite(trace.fault[:10]).all() and np.isfinite(trace.fault[15:]).all(), (library, channel)
            if not est.observer.F[channel].any():  # no fault sits here: the prediction stands in
                assert np.isfinite(trace.corrected[silent]).all(), (library, channel)


@pytest.mark.parametrize("name", METHODS)
def test_a_log_without_a_single_value_ends_in_flags_and_not_in_a_crash(name):
    for library, est in estimators(name).items():
        _, t, u, y = log(library)
        trace = est.replay(t, np.full_like(u, np.nan), np.full_like(y, np.nan))
        assert not trace.ok.any() and np.isfinite(trace.state).all(), library
