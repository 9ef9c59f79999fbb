# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.enclose import lipschitz_bound
from faultrecon.io import library
from faultrecon.io.library import library_names, read_library
from faultrecon.io.plantfile import parse_plant
from faultrecon.io.plantwrite import plant_text


def test_the_aircraft_has_the_matrices_of_example_4_1():
    plant = read_library("lipschitz_aircraft")
    A = """-1.05 -2.55 0 0 -169 -.0091; 2.55 -1.05 0 0 57.09 .0017; 0 0 -77.53 39.57 0 0;
           0 0 0 -20.2 0 0; 0 0 -8.8 0 -20.2 0; 0 0 0 0 0 -.1"""
    C = ".01 .09 .07 0 0 0; -.48 -.59 0 0 -49.51 -.0026; .03 .09 -.06 0 0 0; .26 -.07 .01 0 0 0"
    assert np.array_equal(plant.A, _matrix(A))
    assert np.array_equal(plant.C, _matrix("-" + C)) and np.array_equal(plant.D, np.zeros((4, 1)))
    assert np.array_equal(plant.B, _matrix("0; 0; 0; -4.49; 0; 0"))
    assert np.array_equal(plant.E_w, _matrix("1 0 0; 0 0 0; 1 0 0; 0 0 0; 1 0 0; 1 0 0"))
    assert np.array_equal(plant.F_w, _matrix("0 1 0; 0 0 1; 0 0 0; 0 0 0"))
    assert np.array_equal(plant.F_f, _matrix("0 0; 0 0; 1 0; 0 1"))
    assert all(c.size == 1.0 for c in (*plant.faults, *plant.disturbances))


def test_the_aircraft_saturates_its_first_state_into_the_second_and_fifth():
    term = read_library("lipschitz_aircraft").nonlinearity
    assert term is not None and term.reads == ("x1",) and (term.constant, term.basis) == (1.0, "assumed")
    assert np.array_equal(term.into, _matrix("0; 1; 0; 0; 1; 0"))
    at = np.linspace(-3.0, 3.0, 25)
    values = term.phi.many(at[:, None], np.zeros((25, 1)), np.zeros((25, 1)))[:, 0]
    # Every number here is a multiple of 1/4, so the arithmetic is exact.
    assert np.array_equal(values, np.clip(at, -1.0, 1.0))


def test_the_polynomial_plant_has_the_matrices_of_example_4_2():
    plant = read_library("lipschitz_polynomial")
    assert np.array_equal(plant.A, _matrix("0 1; -1 -1")) and np.array_equal(plant.C, np.eye(2))
    assert np.array_equal(plant.E_w, _matrix("1 0; 1 0")) and np.array_equal(plant.F_w, _matrix("0 1; 0 0"))
    assert np.array_equal(plant.F_f, _matrix("0; 1"))
    term = plant.nonlinearity
    assert term is not None and np.array_equal(term.into, np.eye(2))
    a, b = 0.125, -0.25
    expected = [a**3, -6 * a**5 - 6 * a**2 * b - 2 * a**4 - 2 * a**2]
    assert np.array_equal(term.phi([a, b], [], [0.0]), expected)  # binary fractions: exact


def test_the_constant_of_the_polynomial_plant_is_the_one_that_holds_on_its_box():
    term = read_library("lipschitz_polynomial").nonlinearity
    assert term is not None and (term.constant, term.basis) == (1.17, "assumed")
    box = [term.domain[name] for name in term.reads]
    bound = lipschitz_bound(term.phi, "x", box, others={"u": [], "t": [(0.0, 0.0)]}, rtol=1e-4)
    # The box was chosen, to five digits, as the largest one on which 1.17 holds.
    assert bound.lower == pytest.approx(1.17, abs=1e-4) and bound.value == pytest.approx(1.17, abs=3e-4)


def test_every_plant_of_the_library_reads_and_survives_writing():
    for name in library_names():
        plant = read_library(name)
        assert parse_plant(plant_text(plant)).digest() == plant.digest(), name


def test_the_airliner_is_in_the_library():
    assert {"airliner", "lipschitz_aircraft", "lipschitz_polynomial"} <= set(library_names())
    assert [fault.site for fault in read_library("airliner").faults] == ["sensor"] * 3


def test_an_unknown_plant_is_refused_with_a_suggestion():
    with pytest.raises(InputError, match="no plant 'lipschitz_aircraf'; did you mean 'lipschitz_aircraft'"):
        read_library("lipschitz_aircraf")


def test_a_library_file_that_is_not_installed_is_named(monkeypatch, tmp_path):
    (tmp_path / "plant" / "library").mkdir(parents=True)
    monkeypatch.setattr(library, "files", lambda package: tmp_path)
    with pytest.raises(InputError, match=r"'airliner' is missing: airliner\.toml is not in this installation"):
        read_library("airliner")


def _matrix(text: str) -> np.ndarray:
    return np.array([[float(word) for word in row.split()] for row in text.split(";")])
