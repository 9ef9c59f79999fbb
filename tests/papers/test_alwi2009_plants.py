# SPDX-License-Identifier: BSD-3-Clause
"""The plants of Alwi, Edwards and Tan 2009 as the library ships them: modes, zeros, existence table, refusals."""

from dataclasses import replace

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.diagnosis.conditions import constant_fault, detectable
from faultrecon.diagnosis.existence import detectability_findings
from faultrecon.diagnosis.limits import reconstruction_floor
from faultrecon.numerics.annihilator import annihilator, left_inverse
from faultrecon.numerics.pencil import distance_to_undetectability, invariant_zeros, unobservable_modes
from faultrecon.plant.fault import FaultChannel

ADMIRE, CHAIN = fr.library("admire"), fr.library("two_mass")
SENSOR = {"p": "roll_rate", "q": "pitch_rate", "r": "yaw_rate"}
HIDDEN = [1.076874746, -2.125774746]


def faulty(*rates):
    """ADMIRE with additive faults on the sensors of these rates."""
    return replace(ADMIRE, faults=tuple(FaultChannel(f"f_{r}", {SENSOR[r]: 1.0}) for r in rates))


def augmented(plant):
    """A_a, F_a, C_a with the fault as a state of its own."""
    n, q = plant.n, len(plant.faults)
    A = np.block([[plant.A, np.zeros((n, q))], [np.zeros((q, n + q))]])
    return A, np.vstack([np.zeros((n, q)), np.eye(q)]), np.hstack([plant.C, plant.F_f])


def test_the_modes_of_the_fighter():
    modes = np.sort_complex(np.linalg.eigvals(ADMIRE.A))
    lateral = -0.317711420 + 1.698265245j * np.array([-1, 1])
    assert modes == pytest.approx(np.array([HIDDEN[1], -0.691877161, *lateral, HIDDEN[0]]), abs=1e-8)


def test_the_fighter_measures_roll_yaw_and_pitch_rate_and_the_last_may_fail():
    assert pytest.approx(np.eye(5)[[2, 4, 3]]) == ADMIRE.C
    assert np.array_equal(ADMIRE.F_f, [[0.0], [0.0], [1.0]]) and ADMIRE.faults[0].size == 1.0
    assert ADMIRE.noise is None and not ADMIRE.disturbances and np.isnan(ADMIRE.signals.y.ranges).all()


def test_the_inputs_of_the_fighter_agree_with_an_independent_file_to_rounding():
    # Rows p, q, r of the QCAT toolbox, six digits; the library's entries have four.
    qcat = [[0, -4.242344, 4.242344, 1.487116], [1.653245, -1.273470, -1.273470, 0.002388]]
    qcat.append([0, -0.280465, 0.280465, -0.882328])
    assert np.abs(ADMIRE.B[2:] - qcat).max() <= 5e-5
    assert np.degrees(ADMIRE.signals.u.ranges) == pytest.approx([25, 30, 30, 30])


def test_the_chain_is_that_of_its_masses_springs_and_dampers():
    M, K = np.diag([1.0, 0.5]), np.array([[6.0, -2.0], [-2.0, 2.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -0.1 * np.linalg.solve(M, K)]])
    assert pytest.approx(A, abs=1e-15) == CHAIN.A
    assert np.array_equal(CHAIN.B, [[0], [0], [1], [0]]) and np.array_equal(CHAIN.C, np.eye(4)[:2])
    modes = np.sort_complex(np.linalg.eigvals(CHAIN.A))
    fast, slow = -0.4 + 2.8j * np.array([-1, 1]), -0.1 + 1.41067360j * np.array([-1, 1])
    assert modes == pytest.approx(np.array([*fast, *slow]), abs=1e-8)


def test_the_zeros_with_the_pitch_rate_faulty_are_the_modes_that_the_other_sensors_miss():
    A, F, C = augmented(faulty("q"))
    zeros = invariant_zeros(A, F, C, np.zeros((3, 1)))
    assert np.sort(zeros.real)[::-1] == pytest.approx(HIDDEN, abs=1e-8) and np.abs(zeros.imag).max() < 1e-8
    missed = unobservable_modes(ADMIRE.A, np.eye(5)[[2, 4]])
    assert [m.value for m in missed] == pytest.approx(HIDDEN, abs=1e-8)


def test_the_zeros_of_the_chain_leave_it_minimum_phase():
    assert invariant_zeros(*augmented(CHAIN), np.zeros((2, 1))).size == 0
    assert detectable(CHAIN).holds and reconstruction_floor(CHAIN) is None


# Section 6 of the re-computation: distance of (A, C1) to undetectability and where; sigma_min at the origin; floor.
TABLE = [
    (faulty("q"), 0.0, 1.076874746, 0.8414, 0.9286131034),
    (faulty("r"), 0.8449, None, 0.9362, 0.0),
    (faulty("p"), 0.1443, 1.633j, 0.2427, 0.0),
    (faulty("q", "r"), 0.0, 1.076874746, 0.8414, 0.9286131034),
    (faulty("p", "r"), 0.0927, 1.664j, 0.2713, 0.0),
    (CHAIN, 0.2621, None, None, 0.0),
]


@pytest.mark.parametrize(("plant", "distance", "where", "origin", "floor"), TABLE)
def test_the_existence_table(plant, distance, where, origin, floor):
    C1 = annihilator(plant.F_f) @ plant.C
    value, s = distance_to_undetectability(plant.A, C1)
    assert value == pytest.approx(distance, rel=1e-3, abs=1e-14)  # four digits are tabulated; 4e-16 where it is zero
    assert where is None or s == pytest.approx(where, abs=1e-3)
    assert constant_fault(plant).holds and detectable(plant).holds == (floor == 0)
    limit = reconstruction_floor(plant)
    assert (0.0 if limit is None else limit.value) == pytest.approx(floor, abs=1e-9)
    if origin is not None:
        # The table's coordinates have y2 = C2 x + f for a state in place of f.
        C2, q = left_inverse(plant.F_f) @ plant.C, len(plant.faults)
        M = np.block([[np.vstack([plant.A, C2 @ plant.A]), np.zeros((plant.n + q, q))], [C1, np.zeros((len(C1), q))]])
        M = np.vstack([M, np.eye(q, plant.n + q, plant.n)])
        assert np.linalg.svd(M, compute_uv=False)[-1] == pytest.approx(origin, rel=1e-3)


def test_the_diagnosis_says_what_is_left_for_the_pitch_rate():
    assert "at best an error of 0.928613 s times the rate of the fault" in str(fr.diagnose(ADMIRE))
    (found,) = detectability_findings(ADMIRE)
    assert set(found.evidence["states"]) == {"alpha", "q"}


@pytest.mark.parametrize("method", ["lipschitz-hinf", "open-loop", "filtered-sliding-mode"])
def test_methods_that_need_a_detectable_rest_refuse_the_fighter(method):
    with pytest.raises(fr.Impossible) as refused:
        fr.design(ADMIRE, method)
    assert refused.value.finding.remedies
