# SPDX-License-Identifier: BSD-3-Clause
"""The refused and infeasible cases whose messages are kept, by name; each is a plant and what is asked of it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import faultrecon as fr
from faultrecon.advise.trials import trial_plants
from faultrecon.lmi.solve import Outcome
from faultrecon.plant.matrices import plant_from_matrices


@dataclass(frozen=True)
class Case:
    """A plant, a method and options for which there is no design; solver: what the solver is made to say."""

    plant: Callable[[], fr.Plant]
    method: str = "lipschitz-hinf"
    asked: dict[str, Any] = field(default_factory=dict)
    solver: Outcome | None = None


def polynomial(constant: float = 1.17) -> fr.Plant:
    """Example 4.2, with another Lipschitz constant declared."""
    plant = fr.library("lipschitz_polynomial")
    assert plant.nonlinearity is not None
    return replace(plant, nonlinearity=replace(plant.nonlinearity, constant=constant))


def mass(*faults: fr.FaultChannel) -> fr.Plant:
    """A mass without a spring, two position sensors and a speed sensor."""
    return plant_from_matrices(
        [[0.0, 1.0], [0.0, -0.2]],
        [[0.0], [1.0]],
        [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        np.zeros((3, 1)),
        name="free mass",
        states=["position [m]", "velocity [m/s]"],
        inputs=["force [N]"],
        outputs=["encoder [m]", "laser [m]", "tacho [m/s]"],
        faults=list(faults),
        disturbances=[
            fr.Disturbance("push", {"velocity": 1.0}),
            fr.Disturbance("noise of the encoder", {}, {"encoder": 1.0}, size=1e-3),
            fr.Disturbance("noise of the laser", {}, {"laser": 1.0}, size=1e-3),
            fr.Disturbance("noise of the tacho", {}, {"tacho": 1.0}, size=1e-2),
        ],
    )


ENCODER, LASER = fr.FaultChannel("encoder drift", {"encoder": 1.0}), fr.FaultChannel("laser drift", {"laser": 1.0})
TACHO = fr.FaultChannel("tacho drift", {"tacho": 1.0})
TWIN = fr.FaultChannel("encoder scale", {"encoder": 2.0})
LEAK = fr.FaultChannel("force loss", {"force": 1.0}, site="actuator", size=0.5)


def badly_scaled() -> fr.Plant:
    """A mass whose velocity reaches a sensor through a coefficient that is a mistake in units."""
    plant = mass(LASER)
    C = plant.C.copy()
    C[0, 1] = 1e-9
    return replace(plant, C=C, name="free mass with a stray coefficient")


def sampled() -> fr.Plant:
    """The mass as it is seen every tenth of a second."""
    return replace(mass(LASER), A=np.array([[1.0, 0.1], [0.0, 0.98]]), B=np.array([[0.0], [0.1]]), sample_time=0.1)


def pendulum() -> fr.Plant:
    """A pendulum whose sine is declared to read the velocity too, with a constant that is too large."""
    plant = trial_plants()[1]
    assert plant.nonlinearity is not None
    return replace(plant, nonlinearity=replace(plant.nonlinearity, constant=4.0)).reading_all_states()


CASES = {
    "thau_on_example_4_2": Case(polynomial, "lipschitz-hinf-thau"),
    "alpha_above_the_limit": Case(lambda: polynomial(1.42)),
    "open_loop_on_example_4_2": Case(polynomial, "open-loop"),
    "slope_too_steep_everywhere": Case(lambda: fr.library("lipschitz_aircraft"), "open-loop"),
    "level_below_the_floor": Case(polynomial, asked={"level": 0.5}),
    "level_below_the_optimum": Case(polynomial, asked={"level": 2.0}),
    "phi_reads_too_much": Case(pendulum, asked={"level": 0.35}),
    "faults_that_look_alike": Case(lambda: mass(ENCODER, TWIN)),
    "a_mode_nobody_sees": Case(lambda: mass(ENCODER, LASER)),
    "all_sensors_faulty": Case(lambda: mass(ENCODER, LASER, TACHO)),
    "no_fault": Case(mass),
    "no_disturbance": Case(lambda: replace(mass(LASER), disturbances=())),
    "actuator_fault": Case(lambda: mass(LASER, LEAK)),
    "sampled_plant": Case(sampled),
    "pole_bound_too_small": Case(polynomial, asked={"pole_bound": 0.5}),
    "solver_gives_up": Case(badly_scaled, solver=Outcome("unknown", solver="Clarabel: InsufficientProgress")),
}
