# SPDX-License-Identifier: BSD-3-Clause
"""What every method has to keep to, as checks that anybody can run on a method of their own.

    from faultrecon.testing import check_method
    check_method(MyMethod())                         # raises AssertionError with a sentence, or returns what was tried

or one by one, in the test runner you like:

    @pytest.mark.parametrize("check", all_checks())
    def test_my_method(check):
        check(Trial(MyMethod(), plant))

A method need not be installed to be tried.  A check raises AssertionError and nothing else about a method's faults.
"""

from __future__ import annotations

import functools
import re
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from faultrecon.advise.trials import Trial, awkward, reordered, trial_plants
from faultrecon.certificate import Certificate
from faultrecon.finding import Finding, Impossible
from faultrecon.lmi.expr import Expr, Inequality
from faultrecon.methods.base import Method, Paper, Unproved
from faultrecon.methods.registry import all_methods, method, offered
from faultrecon.plant.plant import Plant

__all__ = ["Trial", "all_checks", "check_method", "trial_plants"]

Array = NDArray[np.float64]
SAME_LEVEL = 1e-4
"""Relative: the solver finds an optimum to about 1e-6, and scales a permuted problem in another order."""
UNIT_GAIN = 0.01
"""A constant fault arrives with gain one to within a per cent, or what comes out is not its waveform."""
_CHECKS: list[Callable[[Trial], None]] = []


def all_checks() -> tuple[Callable[[Trial], None], ...]:
    """Every check, in the order in which they should be read."""
    return tuple(_CHECKS)


def check_method(tried: Method | type[Method] | str, plants: Iterable[Plant] | None = None) -> list[str]:
    """Run every check on every plant that meets the method's assumptions; `trial_plants()` when none is given.

    Returns what was tried, "check on plant".  Raises AssertionError with a sentence, also when no plant was fit to try.
    """
    one = method(tried) if isinstance(tried, str) else tried() if isinstance(tried, type) else tried
    done, refused = [], []
    for plant in trial_plants() if plants is None else plants:
        fatal = [f for f in one.assumptions(plant) if f.severity == "fatal"]
        if fatal:
            refused.append(f"{plant.name}: {fatal[0]}")
            continue
        trial = Trial(one, plant)
        for check in all_checks():
            check(trial)
            done.append(f"{check.__name__} on {plant.name}")
    _claim(bool(done), f"no plant given meets the assumptions of {one.name}, so nothing was tried: {refused}")
    return done


def _claim(true: bool, sentence: str) -> None:
    """AssertionError with the sentence; not an assert statement, which `python -O` leaves out."""
    if not true:
        raise AssertionError(sentence)


def _check(function: Callable[[Trial], None]) -> Callable[[Trial], None]:
    """List a check; while it runs the method is found under its name, and an error on the way is a failure told."""

    @functools.wraps(function)
    def run(trial: Trial) -> None:
        with offered(trial.method):
            try:
                function(trial)
            except AssertionError:
                raise
            except Exception as error:
                where = f"{trial.method.name} on {trial.plant.name}"
                raise AssertionError(f"{where}, {function.__name__}: {type(error).__name__}: {error}") from error

    _CHECKS.append(run)
    return run


# ---------------------------------------------------------------- what a method says about itself


@_check
def check_name_and_paper(trial: Trial) -> None:
    """A name for the command line, one line of summary, a reference to cite; a variant names its method."""
    m = trial.method
    legal = isinstance(m.name, str) and re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", m.name)
    _claim(bool(legal), f"the name {m.name!r} is not made of lower-case words joined by '-'")
    _claim(bool(m.summary.strip()) and "\n" not in m.summary, f"the summary of {m.name} is not one line of text")
    whole = isinstance(m.paper, Paper) and all((m.paper.key, m.paper.authors, m.paper.title, m.paper.venue))
    _claim(whole, f"the paper of {m.name} lacks a key, authors, a title or a venue, so it cannot be cited")
    known = m.variant_of is None or m.variant_of in all_methods()
    _claim(known, f"{m.name} is a variant of '{m.variant_of}', which is no method")


@_check
def check_assumptions(trial: Trial) -> None:
    """Assumptions are findings: returned and not raised, for awkward plants too, the same every time.

    A fatal one forbids the design, in the same words.
    """
    from faultrecon.synthesis.pipeline import design

    for what, plant in awkward(trial.plant).items():
        before = plant.digest()
        try:
            once, again = trial.method.assumptions(plant), trial.method.assumptions(plant)
        except Exception as error:
            raise AssertionError(f"for {what} the assumptions raise {type(error).__name__}: {error}") from error
        findings = isinstance(once, list) and all(isinstance(f, Finding) for f in once)
        _claim(findings, f"for {what} the assumptions are not a list of findings")
        _claim(
            [str(f) for f in once] == [str(f) for f in again], f"for {what} the assumptions differ from call to call"
        )
        _claim(plant.digest() == before, f"for {what} the assumptions change the plant")
        fatal = [f for f in once if f.severity == "fatal"]
        if fatal:
            try:
                design(plant, trial.method.name)
            except Impossible as error:
                _claim(str(error) == str(fatal[0]), f"for {what} the design refuses with other words: {error}")


# ---------------------------------------------------------------- its theorem


@_check
def check_theorem_shapes(trial: Trial) -> None:
    """The parts of the theorem fit each other, and say what is claimed and for what."""
    if isinstance(trial.method, Unproved):
        return  # it claims nothing; check_certificate_holds sees to it that it is a baseline
    th, name = trial.theorem, trial.method.name
    _claim(th.minimise.shape == (1, 1), f"{name} minimises a {th.minimise.shape} matrix, not a number")
    _claim(bool(th.inequalities), f"the theorem of {name} has no inequality")
    _claim(bool(th.claim.strip()) and bool(th.scope.strip()), f"the theorem of {name} lacks a claim or a scope")
    labels = [i.label for i in th.inequalities]
    _claim(all(labels) and len(set(labels)) == len(labels), f"the labels of {name} are not distinct names: {labels}")
    for what, pairs in (("gain", th.gains), ("substitution", th.prove_with)):
        for letter, formula in pairs.items():
            fits = letter.op == "unknown" and letter.shape == formula.shape
            _claim(fits, f"the {what} {letter} {letter.shape} of {name} has a formula of {formula.shape}")
    nz = th.lyapunov.shape[0]
    whole = th.lyapunov.shape == th.drift.shape == (nz, nz) and th.readout.shape[1] == nz and th.noise.shape[0] == nz
    _claim(whole, f"lyapunov, drift, readout and noise of {name} speak of different numbers of states")
    q = len(trial.plant.faults)
    _claim(th.readout.shape[0] == q, f"{name} reads {th.readout.shape[0]} faults out of the error, the plant has {q}")


@_check
def check_theorem_is_typeset(trial: Trial) -> None:
    """Every inequality and every definition has a LaTeX form with balanced braces, and a text form."""
    from faultrecon.lmi.typeset import definitions_latex, inequality_latex, text_block

    if isinstance(trial.method, Unproved):
        return
    inequalities = list(trial.theorem.inequalities)
    for text in [*map(inequality_latex, inequalities), *definitions_latex(inequalities)]:
        depth = np.cumsum([{"{": 1, "}": -1}.get(c, 0) for c in re.sub(r"\\[{}]", "", text)])
        balanced = bool(text.strip()) and depth.size > 0 and depth[-1] == 0 and depth.min() >= 0
        _claim(balanced, f"the braces of {trial.method.name} do not match in {text!r}")
        _claim(text.isprintable(), f"{trial.method.name} is typeset with unprintable letters: {text!r}")
    for inequality in inequalities:
        _claim(bool(text_block(inequality).strip()), f"an inequality of {trial.method.name} has no text form")


@_check
def check_level_ignores_sensor_order(trial: Trial) -> None:
    """The order in which sensors are listed is no physics: the optimum stays."""
    from faultrecon.synthesis.pipeline import optimum

    if trial.design.optimum is None:
        return  # a baseline that claims no level
    order = [*range(1, trial.plant.p), 0]
    level = optimum(reordered(trial.plant, order), trial.method.name)
    close = abs(level - trial.design.optimum) <= SAME_LEVEL * trial.design.optimum
    _claim(
        close, f"the optimum of {trial.method.name} is {trial.design.optimum:.6g}, with sensors reordered {level:.6g}"
    )


# ---------------------------------------------------------------- its gains and its proof


@_check
def check_design_is_deterministic(trial: Trial) -> None:
    """The same plant gives the same gains, level and certificate, bit for bit."""
    one, two, name = trial.design, Trial(trial.method, trial.plant).design, trial.method.name
    for letter, value in one.gains.items():
        _claim(_same(value, two.gains[letter]), f"the gain {letter} of {name} differs from design to design")
    _claim(one.level == two.level, f"the level of {name} differs: {one.level!r} and {two.level!r}")
    digests = [None if d.certificate is None else d.certificate.digests for d in (one, two)]
    _claim(digests[0] == digests[1], f"the certificate of {name} differs from design to design")


@_check
def check_certificate_holds(trial: Trial) -> None:
    """The certificate is of this method's theorem, and the standard library alone proves it."""
    from faultrecon.synthesis.certify import conforms

    made, name = trial.design.certificate, trial.method.name
    if made is None:
        _claim(trial.method.baseline, f"{name} is no baseline and its design carries no certificate")
        return
    _claim(conforms(made, trial.theorem), f"the certificate of {name} does not state its theorem")
    found = made.verify()
    _claim(found.sound, f"the certificate of {name} is refuted: {found}")
    _claim(made.level == trial.design.level, f"{name} ships the level {trial.design.level}, certified is {made.level}")
    _claim(set(made.gains) == set(trial.design.gains), f"the certificate of {name} is about other gains than it ships")


@_check
def check_mutated_certificate_is_refuted(trial: Trial) -> None:
    """A certificate is refuted once a number in it changes, and a false one also when it is sealed anew.

    False are: a level 10 % below the optimum, and every symmetric multiplier with its sign turned.
    """
    made, name = trial.design.certificate, trial.method.name
    if made is None:
        return  # nothing is claimed; check_certificate_holds says who may do that
    for what, changed in _mutations(trial, made).items():
        _claim(not changed.verify().sound, f"the certificate of {name} is still believed with {what}")


def _mutations(trial: Trial, made: Certificate) -> dict[str, Certificate]:
    """False certificates, by what is wrong with them."""
    found = {"another last bit in the level": replace(made, level=float(np.nextafter(made.level, 0.0)))}
    for letter, stored in made.gains.items():
        if stored["hex"]:
            moved = float(np.nextafter(float.fromhex(stored["hex"][0]), np.inf)).hex()
            other = {**stored, "hex": [moved, *stored["hex"][1:]]}
            found[f"another last bit in {letter}"] = replace(made, gains={**made.gains, letter: other})
    optimum = trial.design.optimum
    if optimum:
        found["a level 10 % below the optimum"] = replace(made, level=0.9 * optimum).sealed()
    symmetric = {leaf.name for i in trial.theorem.inequalities for leaf in _symmetric(i)}
    for letter in sorted(symmetric & set(made.data)):
        stored = made.data[letter]
        turned = {**stored, "hex": [(-float.fromhex(v)).hex() for v in stored["hex"]]}
        found[f"-{letter} for {letter}"] = replace(made, data={**made.data, letter: turned}).sealed()
    return found


def _symmetric(inequality: Inequality) -> list[Expr]:
    from faultrecon.lmi.walk import leaves

    return [leaf for leaf in leaves([inequality.expr], "unknown").values() if leaf.args[1]]


@_check
def check_weaker_statement_is_not_the_theorem(trial: Trial) -> None:
    """A certificate that leaves out a step, or claims in other words, is not taken for the theorem."""
    from faultrecon.synthesis.certify import conforms

    made, name = trial.design.certificate, trial.method.name
    if made is None:
        return
    for k, step in enumerate(made.steps):
        weaker = replace(made, steps=(*made.steps[:k], *made.steps[k + 1 :])).sealed()
        _claim(not conforms(weaker, trial.theorem), f"{name} accepts a certificate without the step '{step.label}'")
    other = replace(made, claim=made.claim + " and more").sealed()
    _claim(not conforms(other, trial.theorem), f"{name} accepts a certificate with another claim")


# ---------------------------------------------------------------- its observer


@_check
def check_observer(trial: Trial) -> None:
    """The observer is a pure function of plant and gains, is finite, and takes the plant's faults out of y."""
    name, plant, gains = trial.method.name, trial.plant, trial.design.gains
    before = {letter: value.copy() for letter, value in gains.items()}
    one, two = trial.method.observer(plant, gains), trial.method.observer(plant, gains)
    _claim(all(_same(v, before[k]) for k, v in gains.items()), f"the observer of {name} changes the gains it is given")
    for letter in ("A", "B", "Cx", "Dx", "Cf", "Df", "F", "x0", "u0", "y0"):
        value = getattr(one, letter)
        _claim(bool(np.isfinite(value).all()), f"the observer of {name} has a {letter} that is not finite")
        _claim(_same(value, getattr(two, letter)), f"the observer of {name} differs in {letter} from call to call")
    _claim(_same(one.F, plant.F_f), f"the observer of {name} takes faults out through another matrix than F_f")
    for letter, group in (("x0", "x"), ("u0", "u"), ("y0", "y")):
        right = _same(getattr(one, letter), np.array(getattr(plant.point, group)))
        _claim(right, f"the observer of {name} works about another {letter} than the plant's operating point")


@_check
def check_poles_are_stable(trial: Trial) -> None:
    """Every pole of the observer's linear part decays."""
    poles = trial.design.observer.poles
    sampled = trial.design.observer.sample_time is not None
    growing = poles[np.abs(poles) >= 1] if sampled else poles[np.real(poles) >= 0]
    _claim(not growing.size, f"the observer of {trial.method.name} has poles that do not decay: {growing}")


@_check
def check_constant_fault_arrives(trial: Trial) -> None:
    """A constant fault comes out with gain one and no other fault with it, once the observer has settled."""
    if any(f.site == "actuator" or f.effect == "multiplicative" for f in trial.plant.faults):
        return  # these move the states: how they arrive is not read off the observer alone
    gain = trial.constant_gain
    error = np.abs(gain - np.eye(len(gain))).max()
    _claim(error <= UNIT_GAIN, f"{trial.method.name} shows a constant fault with the gain {np.round(gain, 3).tolist()}")


# ---------------------------------------------------------------- at run time


@_check
def check_steps_are_pure(trial: Trial) -> None:
    """`step` changes nothing it is given, and gives the same bits twice."""
    t, u, y = trial.log
    state = trial.estimator.init()
    for k in range(3):
        given = [np.array(v, copy=True) for v in (u[k], y[k], state.z, state.v)]
        first, second = (trial.estimator.step(state, t[k], u[k], y[k]) for _ in range(2))
        kept = all(_same(a, b) for a, b in zip(given, (u[k], y[k], state.z, state.v), strict=True))
        _claim(kept, f"a step of {trial.method.name} changes what it is given")
        alike = all(_same(getattr(first[1], part), getattr(second[1], part)) for part in _PARTS)
        _claim(alike and _same(first[0].z, second[0].z), f"two steps of {trial.method.name} from one state differ")
        state = first[0]


@_check
def check_replay_is_step_by_step(trial: Trial) -> None:
    """A whole log gives the bits of its steps, with gaps in it too."""
    for what, (t, u, y) in {"a log": trial.log, "a log with gaps": _with_gaps(trial)}.items():
        trace, state = trial.estimator.replay(t, u, y), trial.estimator.init()
        for k in range(len(t)):
            state, estimate = trial.estimator.step(state, t[k], u[k], y[k])
            for part in _PARTS:
                same = _same(getattr(estimate, part), getattr(trace, part)[k])
                _claim(same, f"row {k} of {what} replayed by {trial.method.name} differs from its step in {part}")


@_check
def check_gaps_are_flagged(trial: Trial) -> None:
    """NaN in a sensor: flagged there and nowhere else, never in the state, and gone with its cause."""
    t, u, y = _with_gaps(trial)
    trace, name = trial.estimator.replay(t, u, y), trial.method.name
    gap = ~np.isfinite(y)
    _claim(bool((trace.ok == ~gap).all()), f"{name} does not flag exactly the channels that are missing")
    _claim(bool(np.isfinite(trace.state).all()), f"a gap reaches the state estimate of {name}")
    healthy = ~gap.any(axis=1)
    finite = np.isfinite(trace.fault[healthy]).all() and np.isfinite(trace.corrected[healthy]).all()
    _claim(bool(finite), f"a gap outlasts its cause in the estimates of {name}")


@_check
def check_files_come_back(trial: Trial) -> None:
    """A design survives its file: same gains, same level, same plant, and the proof still holds."""
    from faultrecon.io.designfile import read_design, write_design

    made, name = trial.design, trial.method.name
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "design.json"
        write_design(made, path)
        again = read_design(path, trial.plant)
    alike = set(again.gains) == set(made.gains) and all(_same(v, again.gains[k]) for k, v in made.gains.items())
    _claim(alike, f"the gains of {name} do not survive a file")
    _claim((again.method, again.level) == (name, made.level), f"the level of {name} does not survive a file")


_PARTS = ("fault", "state", "corrected", "ok")


def _with_gaps(trial: Trial) -> tuple[Array, Array, Array]:
    """The log with each sensor missing for three samples in turn, and all of them once; the last rows are whole."""
    t, u, y = trial.log
    y = y.copy()
    for k in range(trial.plant.p):
        y[5 + 4 * k % 24 : 8 + 4 * k % 24, k] = np.nan
    y[32] = np.nan
    return t, u, y


def _same(a: Array, b: Array) -> bool:
    """The same bits, NaN included."""
    a, b = np.asarray(a), np.asarray(b)
    return a.shape == b.shape and a.tobytes() == b.tobytes()
