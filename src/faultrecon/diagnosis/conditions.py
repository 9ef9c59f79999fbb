# SPDX-License-Identifier: BSD-3-Clause
"""The assumptions of the literature as conditions on a plant: whether each holds, and by how much.

Every condition is the full column rank of some pencil at some s; its distance is the smallest singular value there,
relative to a model whose states, columns and rows were brought to comparable size, so that units do not matter.

Unknown inputs are what is to be decoupled (role = "decouple", matrices E_d, F_d), actuator faults (E_f) and sensor
faults (F_f).  Faults are taken as constant or slowly varying where the name says "constant", else as any waveform.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.annihilator import annihilator, column_rank
from faultrecon.numerics.pencil import (
    RANK_TOLERANCE,
    invariant_zeros,
    nearest_undetectable,
    undetectable_modes,
)
from faultrecon.numerics.scaling import scale_states, spectral_norm, state_scaling
from faultrecon.plant.plant import Plant

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Condition:
    """One assumption by the name its paper gives it.

    holds: decided with a tolerance relative to the model.  distance: how far it is from the other answer (relative;
    0 where it fails).  where: the s (or multiplier per sample) that decides, None for a plain rank.  rank, needed: the
    rank found there and the one asked for.  states: where the offending direction lives.
    """

    name: str
    see: str
    holds: bool
    distance: float
    where: complex | None = None
    rank: int = 0
    needed: int = 0
    states: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        where = None if self.where is None else [self.where.real, self.where.imag]
        return {
            "name": self.name,
            "see": self.see,
            "holds": self.holds,
            "distance": self.distance,
            "where": where,
            "rank": self.rank,
            "needed": self.needed,
            "states": list(self.states),
        }


def decoupled_into(plant: Plant) -> Array:
    """E_d (n, d): the disturbances that a design is asked to decouple, into the states."""
    return plant.E_w[:, _decoupled(plant)]


def decoupled_onto(plant: Plant) -> Array:
    """F_d (p, d): the same onto the measurements."""
    return plant.F_w[:, _decoupled(plant)]


@lru_cache(maxsize=64)
def detectable(plant: Plant) -> Condition:
    """(A, C1) detectable: the outputs that no sensor fault reaches see every mode that does not decay."""
    C1 = annihilator(plant.F_f) @ plant.C
    sampled = plant.sample_time is not None
    modes = undetectable_modes(plant.A, C1, sampled=sampled)
    name, see = "(A, C1) detectable", "Khosrowjerdi 2011, section 2; Alwi 2009, Lemma 1"
    if modes:
        return Condition(name, see, False, 0.0, modes[0].value, states=living_in(plant, modes[0].direction))
    if C1.shape[0] == 0:
        return Condition(name, see, True, _decay(plant))
    margin, where = nearest_undetectable(plant.A, C1, sampled=sampled)
    return Condition(name, see, True, margin, where)


@lru_cache(maxsize=64)
def decouplable(plant: Plant) -> Condition:
    """rank(C E_d) = rank(E_d): the first derivative of the measurements shows what is to be decoupled.

    With E_d of full column rank.  A disturbance that also acts on sensors: rank [F_d, 0; C E_d, F_d] = rank F_d + d.
    """
    both = _columns(np.vstack([decoupled_into(plant), decoupled_onto(plant)]))
    E, F, d = both[: plant.n], both[plant.n :], both.shape[1]
    name, see = "rank(C E_d) = rank(E_d)", "Huang 2024, assumption (a); Jia 2015, (12)"
    if not F.any():
        M, needed = plant.C @ E / max(spectral_norm(plant.C), 1e-300), d
    else:
        M = np.block([[F, np.zeros_like(F)], [plant.C @ E, F]])
        needed = column_rank(F) + d
    rank, smallest = _rank(M, needed)
    return Condition(name, see, rank == needed, smallest, None, rank, needed)


@lru_cache(maxsize=64)
def survives(plant: Plant) -> Condition:
    """rank [E_d, E_f] = d + q: no actuator fault enters the states exactly as what is decoupled does (J E != 0)."""
    faulty = plant.E_f[:, _actuator(plant)]
    M = _columns(np.hstack([decoupled_into(plant), faulty]))
    rank, smallest = _rank(M, M.shape[1])
    return Condition("rank(J E_f) = q", "Jia 2015, section 2.2", rank == M.shape[1], smallest, None, rank, M.shape[1])


@lru_cache(maxsize=64)
def minimum_phase(plant: Plant) -> Condition:
    """(A, E_d, C, F_d) has no invariant zero that does not decay, apart from the origin.

    distance: how fast the slowest zero decays, relative to |A|.  The origin is the matter of `constant_fault`.  Without
    anything to decouple it is the detectability of (A, C).
    """
    E, F = decoupled_into(plant), decoupled_onto(plant)
    sampled = plant.sample_time is not None
    zeros = invariant_zeros(plant.A, E, plant.C, F)
    size = max(spectral_norm(plant.A), 1e-300)
    growth = np.abs(zeros) - 1.0 if sampled else zeros.real / size
    at_rest = np.abs(zeros - 1.0) if sampled else np.abs(zeros) / size
    # Zeros are eigenvalues of a pencil: a double one is known to the root of its rounding.
    bad = (growth >= -1e-8) & (at_rest > 1e-8)
    name, see = (
        "(A, E_d, C) minimum phase",
        "Huang 2024, section 3, corrected: (TA, C) detectable; Jia 2015, section 2.3",
    )
    n, d = plant.n, E.shape[1]
    if bad.any():
        s = complex(zeros[bad][int(np.argmax(growth[bad]))])
        rank, v = pencil_rank(plant.A, E, plant.C, F, s)[0], pencil_direction(plant.A, E, plant.C, F, s)
        return Condition(name, see, False, 0.0, s, min(rank, n + d - 1), n + d, living_in(plant, v[:n]))
    inside = growth < -1e-8
    near = -float(np.max(growth[inside], initial=-np.inf))
    where = complex(zeros[inside][int(np.argmax(growth[inside]))]) if inside.any() else None
    return Condition(name, see, True, min(near, 1.0), where, n + d, n + d)


@lru_cache(maxsize=64)
def constant_fault(plant: Plant) -> Condition:
    """rank [A, E_d, E_f, 0; C, F_d, 0, F_f] = n + d + q (A - I when sampled): a constant fault shows at rest.

    Needed whenever faults are modelled as constant between updates (integrators, adaptive laws), because that model
    has its own mode at s = 0, or z = 1.
    """
    A, E, C, F = _unknown_inputs(plant)
    needed = plant.n + E.shape[1]
    rank, smallest = pencil_rank(A, E, C, F, _still(plant))
    names = {0.0: "[A, E; C, F] of full column rank (s = 0)", 1.0: "[A - I, E; C, F] of full column rank (z = 1)"}
    see = "Jia 2015, section 2.3; Huang 2024, section 3, corrected; Alwi 2009, Lemma 2"
    states = () if rank == needed else living_in(plant, pencil_direction(A, E, C, F, _still(plant))[: plant.n])
    where = complex(_still(plant))
    return Condition(names[_still(plant)], see, rank == needed, smallest, where, rank, needed, states)


def constant_fault_matrix(plant: Plant) -> Array:
    """[A, E_d, E_f, 0; C, F_d, 0, F_f] in the units as given, A - I in place of A for a sampled plant."""
    A, E, C, F = _unknown_inputs(plant)
    return np.block([[A - _still(plant) * np.eye(plant.n), E], [C, F]])


def pencil_rank(A: Array, E: Array, C: Array, F: Array, s: complex) -> tuple[int, float]:
    """Rank of [A - sI, E; C, F] in balanced units, and its smallest singular value over the largest."""
    M, _ = _pencil(A, E, C, F, s)
    sigma = np.linalg.svd(M, compute_uv=False)
    rank = int(np.count_nonzero(sigma > RANK_TOLERANCE * max(sigma.max(initial=0.0), 1e-300)))
    full = sigma.size == rank == M.shape[1]
    return rank, float(sigma[-1] / sigma[0]) if full else 0.0


def pencil_direction(A: Array, E: Array, C: Array, F: Array, s: complex) -> Array:
    """States and inputs (n + m,), in the units as given, that [A - sI, E; C, F] all but sends to zero."""
    M, unit = _pencil(A, E, C, F, s)
    return np.linalg.svd(M)[2][-1].conj() * unit


def _pencil(A: Array, E: Array, C: Array, F: Array, s: complex) -> tuple[Array, Array]:
    """[A - sI, E; C, F] in balanced units, rows and columns of comparable size, and the unit of each column."""
    e = state_scaling(A, E, C)
    a, b, c = scale_states(A, E, C, e)
    n = A.shape[0]
    shifted = a - s * np.eye(n)
    top = np.hstack([shifted, b]) / max(spectral_norm(shifted), 1e-300)
    M = np.vstack([top, np.hstack([c, F]) / max(spectral_norm(c), 1e-300)])
    length = np.linalg.norm(M, axis=0)
    length = np.where(length > 0, length, 1.0)
    length[:n] = 1.0
    unit = 1.0 / length
    unit[:n] = np.ldexp(1.0, e)
    return M / length, unit


def living_in(plant: Plant, direction: Array) -> tuple[str, ...]:
    """The (at most three) states in which a direction lives, largest share first; () when it touches none.

    direction: in the plant's units.  States are compared in declared ranges, or in units that balance the model.
    """
    units = state_scaling(plant.A, plant.B, plant.C, np.array(plant.signals.x.ranges, dtype=float))
    weight = np.abs(direction) / np.exp2(units.astype(float))
    if weight.max(initial=0.0) <= 1e-9:
        return ()
    return tuple(plant.signals.x.names[i] for i in np.argsort(-weight) if weight[i] > 0.1 * weight.max())[:3]


def _decoupled(plant: Plant) -> list[bool]:
    return [d.role == "decouple" for d in plant.attenuated]


def _actuator(plant: Plant) -> list[bool]:
    return [f.site == "actuator" for f in plant.faults]


def _still(plant: Plant) -> float:
    return 0.0 if plant.sample_time is None else 1.0


def _unknown_inputs(plant: Plant) -> tuple[Array, Array, Array, Array]:
    into, onto = fault_columns(plant)
    return (
        plant.A,
        np.hstack([decoupled_into(plant), into]),
        plant.C,
        np.hstack([decoupled_onto(plant), onto]),
    )


def fault_columns(plant: Plant) -> tuple[Array, Array]:
    """Every fault into the states (n, q) and onto the measurements (p, q), per physical unit."""
    return plant.E_f, plant.F_f + plant.D @ commands(plant)


def commands(plant: Plant) -> Array:
    """Actuator faults onto the inputs, (m, q): they reach the measurements through D as well."""
    out = np.zeros((len(plant.signals.u), len(plant.faults)))
    for j, f in enumerate(plant.faults):
        if f.site == "actuator":
            for name, coefficient in f.on.items():
                out[plant.signals.u.index(name), j] = coefficient
    return out


def _decay(plant: Plant) -> float:
    """How fast the slowest mode decays, relative to |A|."""
    poles = np.linalg.eigvals(plant.A)
    slowest = 1.0 - np.abs(poles).max() if plant.sample_time is not None else -poles.real.max()
    return float(slowest / max(spectral_norm(plant.A), 1e-300))


def _columns(M: Array) -> Array:
    """Columns of unit length; a zero column stays."""
    length = np.linalg.norm(M, axis=0)
    return M / np.where(length > 0, length, 1.0)


def _rank(M: Array, needed: int) -> tuple[int, float]:
    """Numerical rank of M, and the singular value that decides whether it is `needed`; 0 where it is not."""
    if needed == 0:
        return 0, 1.0
    sigma = np.linalg.svd(M, compute_uv=False) if M.size else np.zeros(0)
    rank = int(np.count_nonzero(sigma > RANK_TOLERANCE))
    return rank, float(sigma[needed - 1]) if rank >= needed else 0.0
