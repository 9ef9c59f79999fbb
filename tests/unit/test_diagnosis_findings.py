# SPDX-License-Identifier: BSD-3-Clause
"""Every finding has its parts: a fact, a cause, a number in evidence where the fact shows one, and a remedy."""

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.diagnosis.diagnosis import diagnose
from faultrecon.finding import Finding
from faultrecon.io.library import library_names, read_library
from faultrecon.methods.registry import list_methods, method
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.matrices import plant_from_matrices

ROOT = Path(fr.__file__).parent
NUMBER = re.compile(r"(?<![\w.,(])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d|[\w,)])")
"""A number of its own: not part of a name, a unit or an equation's number."""

COUNTED = {"all 3 sensors are declared faulty"}
"""Facts whose number is a count that the plant file shows."""

CAUSE_IN_THE_FACT = {"below_floor", "below_method"}
"""Functions whose fact compares two levels and names what the second one is: that is the cause already."""


def mass(*faults, sample_time=None, disturbed=True, **more):
    """A mass without a spring, two position sensors and a speed sensor."""
    disturbances = [Disturbance("push", {"velocity": 1.0})] if disturbed else []
    return plant_from_matrices(
        [[0.0, 1.0], [0.0, -0.2]],
        [[0.0], [1.0]],
        [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        np.zeros((3, 1)),
        name="free mass",
        states=["position [m]", "velocity [m/s]"],
        inputs=["force [N]"],
        outputs=["encoder [mm]", "laser [m]", "tacho [m/s]"],
        faults=list(faults),
        disturbances=disturbances,
        sample_time=sample_time,
        **more,
    )


DRIFTS = [FaultChannel(f"{name} drift", {name: 1.0}) for name in ("encoder", "laser", "tacho")]
LEAK = FaultChannel("force loss", {"force": 1.0}, site="actuator")
SCALE = FaultChannel("encoder gain", {"encoder": 1.0}, effect="multiplicative")
TWIN = FaultChannel("encoder scale", {"encoder": 2.0})
HIDDEN = Disturbance("unknown push", {"velocity": 1.0}, role="decouple")

PLANTS = {
    "nothing asked": mass(),
    "nothing disturbs": mass(DRIFTS[0], disturbed=False),
    "one": mass(DRIFTS[0]),
    "both positions": mass(*DRIFTS[:2]),
    "all sensors": mass(*DRIFTS),
    "alike": mass(DRIFTS[0], TWIN),
    "actuator": mass(LEAK),
    "actuator and sensors": mass(*DRIFTS[:2], LEAK),
    "multiplicative": mass(SCALE),
    "sampled": mass(DRIFTS[0], sample_time=0.1),
    "decouple": replace(mass(DRIFTS[0]), disturbances=(HIDDEN,)),
    "decouple and actuator": replace(mass(LEAK), disturbances=(HIDDEN,)),
    "by a hair": replace(mass(DRIFTS[2]), C=np.array([[1e-9, 1.0], [0.0, 1.0], [0.0, 1.0]])),
    **{name: read_library(name) for name in library_names()},
}


def whole(found: Finding, plant: fr.Plant) -> bool:
    """Whether a finding has every part; a number of the fact, unless it is in the plant's name, is a value too."""
    said = found.what.replace(plant.name, "")
    values = [v for v in found.evidence.values() if isinstance(v, (int, float, list, tuple, dict))]
    numbers = bool(values) or not NUMBER.search(said) or said in COUNTED
    return bool(found.what and found.why and found.remedies and numbers)


@pytest.mark.parametrize("name", PLANTS)
def test_every_finding_of_a_diagnosis_is_whole(name):
    found = diagnose(PLANTS[name])
    for one in [*found.notes, *(f for d in (found.together, *found.alone) for f in d.findings)]:
        assert whole(one, PLANTS[name]), one


@pytest.mark.parametrize("kind", list_methods(variants=True))
def test_every_assumption_that_a_method_refuses_is_whole(kind):
    for plant in PLANTS.values():
        for one in method(kind).assumptions(plant):
            assert whole(one, plant), (kind, plant.name, one)


def findings_written(path):
    """Every `Finding(...)` of a file with the function it stands in."""
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(function, ast.FunctionDef):
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding":
                    yield function.name, node


@pytest.mark.parametrize("folder", ["diagnosis", "methods", "advise", "synthesis/refusals.py"])
def test_no_finding_is_written_without_cause_and_remedy(folder):
    place = ROOT / folder
    for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
        for function, call in findings_written(path):
            parts = {k.arg for k in call.keywords} | set(("what", "why", "evidence", "remedies")[: len(call.args)])
            missing = {"why", "remedies"} - parts - ({"why"} if function in CAUSE_IN_THE_FACT else set())
            assert not missing, f"{path.name}:{call.lineno} {function} has no {missing}"
            empty = [k.arg for k in call.keywords if isinstance(k.value, ast.Tuple) and not k.value.elts]
            assert not empty, f"{path.name}:{call.lineno}"
