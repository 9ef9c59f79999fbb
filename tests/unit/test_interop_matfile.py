# SPDX-License-Identifier: BSD-3-Clause
import io
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat, savemat

from faultrecon.finding import InputError
from faultrecon.io.library import library_names, read_library
from faultrecon.io.matfile import read_mat, write_mat
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.matrices import FindingWarning
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Noise, Signals

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
POSITIVE = st.floats(1e-300, 1e300)
TITLES = st.text(
    st.characters(blacklist_categories=["Cs", "Cc"]), min_size=1, max_size=12
).filter(lambda text: text == text.strip() and text.isprintable())  # fmt: skip


@st.composite
def plants(draw):
    """Any linear plant: sizes from one, names, units, ranges, channels of every kind."""
    n, m, p = draw(st.integers(1, 3)), draw(st.integers(0, 3)), draw(st.integers(1, 3))

    def matrix(rows, columns):
        return np.array(draw(st.lists(NUMBERS, min_size=rows * columns, max_size=rows * columns))).reshape(
            rows, columns
        )

    def channels(letter, size):
        ranges = [draw(st.just(math.nan) | POSITIVE) for _ in range(size)]
        units = [draw(st.sampled_from(["", "rad/s", "°C", "m·s⁻¹"])) for _ in range(size)]
        limited = letter != "x" and draw(st.booleans())
        limits = [(draw(st.just(-math.inf) | st.floats(-9, -1)), draw(st.just(math.inf) | POSITIVE)) for _ in ranges]
        names = tuple(f"{letter}_{k}" for k in range(size))
        return Channels(names, tuple(units), tuple(ranges), tuple(limits) if limited else ())

    def table(names):
        return {name: draw(NUMBERS) for name in draw(st.lists(st.sampled_from(names), unique=True))}

    signals = Signals(channels("x", n), channels("u", m), channels("y", p))
    titles = draw(st.lists(TITLES, min_size=4, max_size=4, unique=True))
    sensor = {**table(signals.y.names), signals.y.names[0]: draw(NUMBERS.filter(bool))}
    faults = [FaultChannel(titles[0], sensor, "sensor", draw(st.sampled_from(["additive", "multiplicative"])))]
    if m:
        rate = draw(st.just(math.inf) | POSITIVE)
        faults.append(FaultChannel(titles[1], {signals.u.names[0]: 1.0}, "actuator", size=draw(POSITIVE), rate=rate))
    disturbances = [
        Disturbance(title, table(signals.x.names), table(signals.y.names), role, draw(POSITIVE))
        for title, role in zip(titles[2:], ("decouple", "noise"), strict=True)
    ]
    point = OperatingPoint(*(tuple(draw(NUMBERS) for _ in range(k)) for k in (n, m, p)))
    noise = Noise(draw(POSITIVE), tuple(draw(st.just(0.0) | POSITIVE) for _ in range(p)))
    return Plant(
        draw(TITLES | st.just("")),
        signals,
        matrix(n, n),
        matrix(n, m),
        matrix(p, n),
        matrix(p, m),
        tuple(draw(st.permutations(faults)))[: draw(st.integers(0, 2))],
        tuple(disturbances[: draw(st.integers(0, 2))]),
        noise=draw(st.just(noise) | st.none()),
        operating_point=draw(st.just(point) | st.none()),
        sample_time=draw(st.none() | POSITIVE),
        source=draw(st.just("") | TITLES),
    )


@settings(max_examples=60, deadline=None)
@given(plant=plants())
def test_a_linear_plant_survives_a_mat_file_to_the_last_bit(plant, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "any.mat"
    write_mat(plant, path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = read_mat(path)
    assert again.digest() == plant.digest() and again.source == plant.source
    first = path.read_bytes()
    write_mat(again, path)
    assert path.read_bytes() == first  # no time of day in the header


def test_the_linear_plants_of_the_library_survive_and_the_others_are_refused_with_a_way_out(tmp_path):
    kinds = set()
    for name in library_names():
        plant = read_library(name)
        linear = plant.nonlinearity is None and plant.known is None
        kinds.add(linear)
        if linear:
            write_mat(plant, tmp_path / "plant.mat")
            assert read_mat(tmp_path / "plant.mat").digest() == plant.digest()
        else:
            with pytest.raises(InputError, match=r"cannot hold the nonlinear part .* save it as \.toml"):
                write_mat(plant, tmp_path / "nonlinear.mat")
    assert kinds == {True, False} and not (tmp_path / "nonlinear.mat").exists()


def test_what_is_written_is_what_matlab_users_expect_by_name(tmp_path):
    write_mat(small(), tmp_path / "plant.mat")
    found = loadmat(tmp_path / "plant.mat", simplify_cells=True)
    assert found["A"].tolist() == [[0, 1], [-4, -1]] and found["Ts"] == 0.01
    assert found["x_names"].tolist() == ["q", "v"] and found["y_units"] == "m"
    assert found["noise"]["hold"] == 0.01 and found["faults"]["name"] == "drift"
    assert found["disturbances"]["into_signals"] == "v"


def test_text_that_the_format_would_change_is_refused_before_anything_is_written(tmp_path):
    for plant in (replace(small(), name="ends in zero\0"), replace(small(), source="\0")):
        with pytest.raises(InputError, match=r"plant.mat: the plant cannot be written as .mat: (name|source) would"):
            write_mat(plant, tmp_path / "plant.mat")
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------- files of others


def small():
    return Plant(
        "small",
        Signals(
            Channels.declared(["q [m]", "v [m/s]"]), Channels.declared(["force [N]"]), Channels.declared(["y [m]"])
        ),
        np.array([[0.0, 1.0], [-4.0, -1.0]]),
        np.array([[0.0], [1.0]]),
        np.array([[1.0, 0.0]]),
        np.array([[0.0]]),
        faults=(FaultChannel("drift", {"y": 1.0}),),
        disturbances=(Disturbance("gust", {"v": 1.0}),),
        noise=Noise(0.01, (1e-3,)),
        sample_time=0.01,
    )


MATRICES = {"A": [[0.0, 1], [-4, -1]], "B": [[0.0], [1]], "C": [[1.0, 0]], "D": [[0.0]]}


def stranger(path, **variables):
    """A file as somebody else would write it."""
    savemat(path, {name: value for name, value in {**MATRICES, **variables}.items() if value is not None})
    return path


def cells(*texts):
    out = np.empty((len(texts), 1), dtype=object)
    out[:, 0] = texts
    return out


def test_four_matrices_are_a_plant_with_numbered_names_called_as_its_file(tmp_path):
    plant = read_mat(stranger(tmp_path / "pendulum.mat"))
    assert plant.name == "pendulum" and plant.sample_time is None
    assert [g.names for g in (plant.signals.x, plant.signals.u, plant.signals.y)] == [("x1", "x2"), ("u1",), ("y1",)]
    assert np.array_equal(plant.A, MATRICES["A"]) and np.array_equal(plant.D, [[0.0]])


@pytest.mark.parametrize("given", [{"B": None, "D": None}, {"B": np.zeros((0, 0)), "D": np.zeros((0, 0))}])
def test_without_B_and_D_there_is_no_input(tmp_path, given):
    assert read_mat(stranger(tmp_path / "plant.mat", **given)).B.shape == (2, 0)


def test_integers_single_precision_logical_sparse_and_row_vectors_serve(tmp_path):
    from scipy.sparse import csc_array

    plant = read_mat(
        stranger(
            tmp_path / "plant.mat",
            A=csc_array(np.array(MATRICES["A"])),
            B=np.array([[0], [1]], dtype=np.int16),
            C=np.array([[True, False]]),
            D=np.array([[0.5]], dtype=np.float32),
            x0=[1.0, 2.0],
            x_names=cells("q [m]", "v [m/s]"),
            y_names=np.array(["out"]),
        )
    )
    assert plant.point.x == (1.0, 2.0) and plant.D[0, 0] == 0.5 and plant.signals.x.units == ("m", "m/s")
    assert plant.signals.y.names == ("out",) and np.array_equal(plant.A, MATRICES["A"])


def test_variables_without_a_meaning_are_told_and_not_read(tmp_path):
    path = stranger(tmp_path / "plant.mat", nois=1.0, scratch=cells("a"))
    with pytest.warns(FindingWarning, match="not read: nois, scratch; 'nois': did you mean 'noise'"):
        read_mat(path)


BAD = {
    "A missing": ({"A": None}, ["there is no variable A", "it holds B, C, D", "-append"]),
    "C missing": ({"C": None}, ["there is no variable C"]),
    "a for A": ({"A": None, "a": 1.0}, ["rename the variable a to A"]),
    "in a struct": ({"A": None, "sys": {"A": 1.0}}, ["unpack sys first: save('plant.mat', '-struct', 'sys'"]),
    "A not square": ({"A": [[0.0, 1]]}, ["A is (1, 2)", "ask for (1, 1)"]),
    "B too short": ({"B": [[1.0]]}, ["B is (1, 1)", "ask for (2, 1)"]),
    "D too wide": ({"D": [[0.0, 0]]}, ["D is (1, 2)", "ask for (1, 1)"]),
    "NaN": ({"A": [[0.0, 1], [math.nan, -1]]}, ["A holds nan", "at (2,1)"]),
    "Inf": ({"C": [[math.inf, 0]]}, ["C holds inf", "at (1,1)"]),
    "complex": ({"A": [[0.0, 1], [1j, -1]]}, ["A is complex"]),
    "three dimensions": ({"A": np.zeros((2, 2, 2))}, ["A has 3 dimensions"]),
    "cell for A": ({"A": cells(1.0, 2.0)}, ["variable A is a cell", "holds numbers"]),
    "text for A": ({"A": "eye(2)"}, ["variable A is text"]),
    "struct for names": ({"x_names": {"a": 1}}, ["x_names is a struct", "cell or char"]),
    "number among names": ({"x_names": cells("q", 3.0)}, ["x_names{2} is no line of text", "write it in quotes"]),
    "square cell of names": ({"x_names": np.array([["a", "b"], ["c", "d"]], dtype=object)}, ["2 by 2 cell"]),
    "too few names": ({"x_names": cells("q")}, ["x_names has 1 entries", "ask for 2"]),
    "illegal name": ({"x_names": cells("q", "pitch rate")}, ["'pitch rate' is no signal name"]),
    "nested cell": ({"x_names": cells("q", cells("v"))}, ["x_names{2} is no line of text"]),
    "units in cells of cells": ({"x_units": cells("m", cells("s"))}, ["x_units{2}"]),
    "long x0": ({"x0": [1.0, 2, 3]}, ["x0 has 3 entries", "ask for 2"]),
    "matrix x0": ({"x0": np.zeros((2, 2))}, ["x0 is (2, 2)", "a row or a column"]),
    "two sample times": ({"Ts": [0.1, 0.2]}, ["Ts is (1, 2)", "one number"]),
    "negative sample time": ({"Ts": -1.0}, ["the sample time is -1.0"]),
    "noise as number": ({"noise": 0.1}, ["variable noise is a double", "struct"]),
    "noise without sd": ({"noise": {"hold": 0.1}}, ["noise has no field sd", "its fields are hold"]),
    "noise misspelt": ({"noise": {"hold": 0.1, "sds": 1.0}}, ["has a field sds", "did you mean 'sd'"]),
    "negative noise": ({"noise": {"hold": 0.1, "sd": -1.0}}, ["a noise standard deviation is -1.0"]),
    "unknown sensor": (
        {"faults": {"name": "f", "signals": cells("y9"), "coefficients": 1.0}},
        ["no signal 'y9'", "known: y1"],
    ),
    "fault of two minds": (
        {"faults": {"name": "f", "signals": cells("y1", "y1"), "coefficients": [1.0, 2]}},
        ["faults.signals names a signal twice"],
    ),
    "wrong role": ({"disturbances": {"name": "w", "role": "annoy"}}, ["role 'annoy'", "use attenuate"]),
    "newer schema": ({"faultrecon_schema": 2.0}, ["faultrecon_schema is 2", "use a newer release"]),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_file_that_makes_no_plant_is_refused_with_file_variable_and_value(tmp_path, case):
    given, words = BAD[case]
    path = stranger(tmp_path / "plant.mat", **given)
    with pytest.raises(InputError) as refused, warnings.catch_warnings():
        warnings.simplefilter("ignore", FindingWarning)
        read_mat(path)
    text = str(refused.value)
    assert text.startswith(f"{path}: ") and all(word in text for word in words), text


def test_version_7_3_is_refused_with_the_command_that_writes_version_7(tmp_path):
    path = tmp_path / "new.mat"
    for head in (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512), b"\x89HDF\r\n\x1a\n" + bytes(600)):
        path.write_bytes(head + b"\x89HDF\r\n\x1a\n" + bytes(100))
        with pytest.raises(InputError, match=r"version 7.3 \(HDF5\).*'-v7'\)"):
            read_mat(path)


@pytest.mark.parametrize("data", [b"", b"\0" * 4096, b"hello", b"A = eye(2)\n" * 50, b"\x80\x04pickle" * 40])
def test_what_is_no_mat_file_is_refused(tmp_path, data):
    path = tmp_path / "other.mat"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"other\.mat"):
        read_mat(path)


def test_missing_files_and_folders_are_refused(tmp_path):
    for path in (tmp_path / "absent.mat", tmp_path):
        with pytest.raises(InputError, match=r"cannot be read|is a folder"):
            read_mat(path)


def test_a_truncated_file_is_refused_or_lacks_what_was_cut_and_never_crashes(tmp_path):
    stream = io.BytesIO()
    savemat(stream, MATRICES)
    whole = stream.getvalue()
    path = tmp_path / "cut.mat"
    for length in range(0, len(whole), 8):
        path.write_bytes(whole[:length])
        # D is the last variable and may be absent; the others may not.
        try:
            plant = read_mat(path)
        except InputError as error:
            assert "cut.mat" in str(error)
        else:
            assert np.array_equal(plant.C, MATRICES["C"])


def test_limits_of_a_file_by_hand_are_read_and_refused_by_name(tmp_path):
    matrices = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "y_names": np.array(["h [cm]"], dtype=object)}
    path = tmp_path / "plant.mat"
    savemat(path, {**matrices, "u_limits": [[-math.inf, 5.0]], "y_limits": [[0.0, 50.0]], "y_ranges": [[2.0]]})
    found = read_mat(path).signals
    assert found.u.limits == ((-math.inf, 5.0),) and found.y.limits == ((0.0, 50.0),)
    assert (found.y.units, found.y.ranges) == (("cm",), (2.0,))
    savemat(path, {**matrices, "y_limits": [[0.0], [50.0]]})
    with pytest.raises(InputError, match=r"y_limits is \(2, 1\): it has a row for each of 1 signals"):
        read_mat(path)
    savemat(path, {**matrices, "y_limits": [[50.0, 0.0]]})
    with pytest.raises(InputError, match=r"plant\.mat: the limits of h are 50 and 0"):
        read_mat(path)
