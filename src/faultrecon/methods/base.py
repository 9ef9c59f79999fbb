# SPDX-License-Identifier: BSD-3-Clause
"""What a method is: a paper's notation, assumptions, theorem, observer and reproductions.

A method file writes its inequality in the paper's letters and says how the gains that ship enter it again; everything
else (solving, backing off, rounding, proving, running, documenting) reads from that.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from faultrecon.diagnosis.limits import Floor, reconstruction_floor
from faultrecon.finding import Finding
from faultrecon.graph.observer import CopiedTerm, NonlinearTerm, Observer
from faultrecon.lmi.expr import Expr, Inequality, given
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.plant import Plant

Status = Literal["as_printed", "with_change", "not_as_printed", "re_derived"]


@dataclass(frozen=True)
class Paper:
    """A reference, enough to cite."""

    key: str
    authors: str
    year: int
    title: str
    venue: str
    doi: str = ""

    def __str__(self) -> str:
        doi = f" doi:{self.doi}" if self.doi else ""
        return f"{self.authors} ({self.year}). {self.title}. {self.venue}.{doi}"


@dataclass(frozen=True)
class Reproduction:
    """One printed number of a paper beside what this code computes for it.

    plant: library name.  options: passed to `synthesis.optimum`.  printed: the paper's value, None if it prints none.
    expected: our reference value with its relative tolerance.  status and reason: what holds, said plainly.
    """

    item: str
    plant: str
    printed: float | None
    expected: float
    rtol: float
    status: Status
    reason: str
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Identity:
    """A matrix that has to vanish for the claim to hold; entries up to `tolerance` are rounding of stored data."""

    label: str
    expr: Expr
    tolerance: float = 0.0


@dataclass(frozen=True)
class Assumed:
    """A premise that this certificate does not prove."""

    label: str
    text: str
    verdict: Literal["assumed", "checked", "proved"] = "assumed"


@dataclass(frozen=True, eq=False)
class Theorem:
    """A theorem as a semidefinite program, and how to prove it for the gains that ship.

    filter: the arguments of `numerics.level.optimal_level`, when the theorem is that one inequality in P, L and β.
    unit: what γ is multiplied by inside the program, so that it is near one there.

    minimise: (1, 1) expression of the level to the given power, 2 unless said otherwise.  gains: unknown that ships -> its formula.  prove_with: unknown
    of the program -> its expression in the gains that ship, substituted before the proof.  lyapunov P, drift P (A - L C1),
    readout H1 and noise (P L times sensor noise, one column per unit white source) serve the second criterion; a theorem
    that has one of its own names the expression whose largest eigenvalue is then to be least in `mildest`, and says so in `criterion`.
    drifts: the drift at every vertex, where there are several; the pole bound then holds for each.
    bases: given letters that any matrices may stand for that pass the identities: coordinates, found by the method.
    bounds: letters among `fixed` below whose zero the inequalities do not give the claim, and what is lost at zero.
    """

    number: str
    inequalities: Sequence[Inequality]
    minimise: Expr
    gains: Mapping[Expr, Expr]
    prove_with: Mapping[Expr, Expr]
    claim: str
    scope: str
    lyapunov: Expr
    drift: Expr
    readout: Expr
    noise: Expr
    identities: Sequence[Identity] = ()
    premises: Sequence[Assumed] = ()
    fixed: Mapping[str, Any] = field(default_factory=dict)
    filter: Mapping[str, Expr] | None = None
    unit: float = 1.0
    power: int = 2
    mildest: Expr | None = None
    criterion: str = "the mildest gains: least largest eigenvalue of P"
    drifts: Sequence[Expr] = ()
    bases: Sequence[str] = ()
    bounds: Mapping[str, str] = field(default_factory=dict)

    def objective(self, level: float) -> float:
        """What is minimised, at a level γ."""
        return (self.unit * level) ** self.power

    def level(self, objective: float) -> float:
        """The level γ at a value of what is minimised."""
        return max(objective, 0.0) ** (1.0 / self.power) / self.unit


@dataclass(frozen=True)
class Scaling:
    """Units in which the numbers are near one: exponents of two per state (n,), per healthy output (p1,), of the error."""

    state: NDArray[np.int64]
    output: NDArray[np.int64]
    error: int = 0


@dataclass(frozen=True, eq=False)
class Letters:
    """The plant's matrices as letters of a statement; scaled units of states x = T x_s, healthy outputs, error U e_f."""

    plant: Plant
    T: Expr
    Ti: Expr
    R: Expr
    Ri: Expr
    U: Expr
    Ui: Expr

    def __getitem__(self, name: str) -> Expr:
        return given(f"plant.{name}", self.plant.letters()[name])


def letters(plant: Plant, scaling: Scaling) -> Letters:
    """The plant's letters beside the scaling of its states (T), healthy outputs (R) and reconstruction error (U)."""
    t, r = np.exp2(scaling.state.astype(float)), np.exp2(scaling.output.astype(float))
    return Letters(
        plant,
        given("T", np.diag(t)),
        given("T⁻¹", np.diag(1 / t)),
        given("R", np.diag(r).reshape(len(r), len(r))),
        given("R⁻¹", np.diag(1 / r).reshape(len(r), len(r))),
        given("U", 2.0**scaling.error),
        given("U⁻¹", 2.0**-scaling.error),
    )


def deviations(plant: Plant) -> dict[str, Any]:
    """The operating point and the nonlinear parts of an observer whose state is x̂ - x0."""
    point = {k: np.array(getattr(plant.point, k[0])) for k in ("x0", "u0", "y0")}
    term, known = plant.nonlinearity, plant.known
    nonlinear = copied = None
    if term is not None:
        lower, upper = term.limits
        H = term.selection(plant.signals.x)
        nonlinear = NonlinearTerm(term.into, H, H @ point["x0"], lower, upper, term.phi)
    if known is not None:
        copied = CopiedTerm(known.into, known.g)
    return {**point, "nonlinear": nonlinear, "copied": copied}


def lipschitz_premises(plant: Plant) -> list[Assumed]:
    """The bound on φ, and who says so."""
    if plant.nonlinearity is None:
        return []
    term = plant.nonlinearity
    how = "proved by ball arithmetic, not rechecked here" if term.basis == "proved" else "declared with the plant"
    bound = f"|φ(a) - φ(b)| ≤ {term.constant:.9g} |a - b| on the domain"
    return [Assumed("Lipschitz constant", f"{bound}: {how}", term.basis)]


def lipschitz_scope(plant: Plant) -> str:
    """What a guarantee for the continuous-time error system covers, and what it does not."""
    text = "covers the continuous-time error system in exact arithmetic with these gains"
    if plant.nonlinearity is not None:
        text += f" for a Lipschitz constant up to {plant.nonlinearity.constant:.9g}"
        if plant.nonlinearity.domain:
            box = ", ".join(f"{k} in [{a:g}, {b:g}]" for k, (a, b) in plant.nonlinearity.domain.items())
            text += f" while the plant stays in {box}"
    text += "; w holds the disturbances that are declared to be attenuated"
    if plant.noise is not None or len(plant.attenuated) < len(plant.disturbances):
        text += ", and noise only as far as it is declared among them"
    return text + "; does not cover sampling, rounding at run time, or a plant that differs from the model"


@dataclass(frozen=True)
class ClosedForm:
    """Gains without a semidefinite program: the smallest level of that route, and the program's unknowns at a level.

    at: from a level to values by letter of which `Theorem.gains` makes the gains; None where it finds none there.
    """

    optimum: float
    at: Callable[[float], Mapping[str, NDArray[np.float64]] | None]
    name: str


class Method(ABC):
    """A published method.  Subclasses are found by scanning `faultrecon.methods` and the entry-point group.

    backoff: how far above its optimum a design stays unless told otherwise.  sampled: its observers are maps from one
    sample to the next, so that no pole is too fast for them.  counts_rates: whether the level counts the faults' rates.
    criterion: how gains that need no theorem are picked, in words.  level_of: whether γ is a gain from counted
    disturbances to the error, or a standard deviation under declared white noise.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    paper: ClassVar[Paper]
    baseline: ClassVar[bool] = False
    variant_of: ClassVar[str | None] = None
    backoff: ClassVar[float] = 0.05
    counts_rates: ClassVar[bool] = False
    sampled: ClassVar[bool] = False
    criterion: ClassVar[str] = "none: there is nothing to choose"
    level_of: ClassVar[Literal["gain", "deviation"]] = "gain"
    reproductions: ClassVar[Sequence[Reproduction]] = ()

    @abstractmethod
    def assumptions(self, plant: Plant) -> list[Finding]:
        """What the plant violates of the paper's assumptions, by the paper's names; fatal ones forbid a design."""

    @abstractmethod
    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """The theorem for this plant."""

    @abstractmethod
    def observer(self, plant: Plant, gains: Mapping[str, NDArray[np.float64]]) -> Observer:
        """The executable equations with these gains."""

    def counted(self, plant: Plant) -> tuple[Disturbance, ...] | None:
        """The disturbances that the level counts; None where no simulated error can be held against it."""
        return plant.attenuated

    def sampling(self, values: Mapping[str, Any]) -> Method:
        """The method for the sample time among `values` (what a user fixes), if it is one that is made for one."""
        return self

    def unsolvable(self, plant: Plant) -> Finding | None:
        """What a user should read in place of the solver's dual certificate when the inequality has no solution."""
        return None

    def closed_form(self, plant: Plant) -> ClosedForm | None:
        """Another route to the gains than the program, which then is asked for the multipliers of the proof alone."""
        return None

    def stand_in(self, plant: Plant) -> Plant | None:
        """Another plant to find the gains for, where those for this one would lean on what it hardly shows.

        The proof is about the plant itself all the same.
        """
        return None

    def floor(self, plant: Plant) -> Floor | None:
        """What no estimator beats, in the terms of this method's level; None where none is known."""
        return reconstruction_floor(plant)

    def notes(self, plant: Plant, gains: Mapping[str, NDArray[np.float64]]) -> tuple[str, ...]:
        """What else a user of these gains should read in the report."""
        return ()

    def gains_without_proof(self, plant: Plant) -> dict[str, NDArray[np.float64]] | None:
        """Gains that need no theorem to be run (a baseline's), or None."""
        return None


class Unproved(Method):
    """A baseline that claims nothing: it ships `gains_without_proof`, and its designs carry no certificate."""

    baseline = True

    def theorem(self, plant: Plant, scaling: Scaling) -> Theorem:
        """There is none."""
        raise NotImplementedError(f"{self.name} claims nothing, so it has no theorem")
