# SPDX-License-Identifier: BSD-3-Clause
"""faultrecon reconstructs faults: the waveform of a sensor fault, the corrected measurement, and a proof.

Everything public is here and loads on first use; importing the package needs the standard library alone.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_DOOR = {
    "load": "faultrecon.io.door",
    "save": "faultrecon.io.door",
    "library": "faultrecon.io.door",
    "library_names": "faultrecon.io.library",
    "reconstruct": "faultrecon.io.playback",
    "replay": "faultrecon.io.playback",
    "read_log": "faultrecon.io.logs",
    "write_log": "faultrecon.io.logs",
    "diagnose": "faultrecon.diagnosis.diagnosis",
    "design": "faultrecon.advise.designing",
    "optimum": "faultrecon.synthesis.pipeline",
    "bank": "faultrecon.synthesis.bank",
    "watch": "faultrecon.io.watched",
    "list_methods": "faultrecon.methods.registry",
    "cite": "faultrecon.methods.registry",
    "verify": "faultrecon.certificate",
    "score": "faultrecon.simulation.metrics",
    "discretised": "faultrecon.plant.derive",
    "equilibrium": "faultrecon.plant.derive",
    "linearise": "faultrecon.plant.derive",
    "linearised": "faultrecon.plant.derive",
    "simulate": "faultrecon.simulation.run",
    "Run": "faultrecon.simulation.run",
    "Scenario": "faultrecon.simulation.scenario",
    "study": "faultrecon.simulation.study",
    "trial": "faultrecon.simulation.trial",
    "compare": "faultrecon.advise.comparison",
    "recommend": "faultrecon.advise.recommendation",
    "best": "faultrecon.advise.recommendation",
    "why_not": "faultrecon.advise.why_not",
    "reproduce": "faultrecon.advise.reproductions",
    "Plant": "faultrecon.plant.plant",
    "OperatingPoint": "faultrecon.plant.plant",
    "Signals": "faultrecon.plant.signals",
    "Channels": "faultrecon.plant.signals",
    "Noise": "faultrecon.plant.signals",
    "FaultChannel": "faultrecon.plant.fault",
    "Disturbance": "faultrecon.plant.fault",
    "Lipschitz": "faultrecon.plant.lipschitz",
    "Graph": "faultrecon.graph.function",
    "Design": "faultrecon.synthesis.result",
    "Certificate": "faultrecon.certificate",
    "Diagnosis": "faultrecon.diagnosis.diagnosis",
    "Estimator": "faultrecon.runtime.estimator",
    "Bank": "faultrecon.synthesis.bank",
    "Monitor": "faultrecon.runtime.monitor",
    "Intake": "faultrecon.runtime.intake",
    "Log": "faultrecon.io.logs",
    "Finding": "faultrecon.finding",
    "FaultreconError": "faultrecon.finding",
    "InputError": "faultrecon.finding",
    "Impossible": "faultrecon.finding",
    "Inconclusive": "faultrecon.finding",
}

__all__ = [
    "Bank",
    "Certificate",
    "Channels",
    "Design",
    "Diagnosis",
    "Disturbance",
    "Estimator",
    "FaultChannel",
    "FaultreconError",
    "Finding",
    "Graph",
    "Impossible",
    "Inconclusive",
    "InputError",
    "Intake",
    "Lipschitz",
    "Log",
    "Monitor",
    "Noise",
    "OperatingPoint",
    "Plant",
    "Run",
    "Scenario",
    "Signals",
    "__version__",
    "bank",
    "best",
    "cite",
    "compare",
    "design",
    "diagnose",
    "discretised",
    "equilibrium",
    "library",
    "library_names",
    "linearise",
    "linearised",
    "list_methods",
    "load",
    "optimum",
    "read_log",
    "recommend",
    "reconstruct",
    "replay",
    "reproduce",
    "save",
    "score",
    "simulate",
    "study",
    "trial",
    "verify",
    "watch",
    "why_not",
    "write_log",
]

if TYPE_CHECKING:
    from faultrecon.advise.comparison import compare
    from faultrecon.advise.designing import design
    from faultrecon.advise.recommendation import best, recommend
    from faultrecon.advise.reproductions import reproduce
    from faultrecon.advise.why_not import why_not
    from faultrecon.certificate import Certificate, verify
    from faultrecon.diagnosis.diagnosis import Diagnosis, diagnose
    from faultrecon.finding import FaultreconError, Finding, Impossible, Inconclusive, InputError
    from faultrecon.graph.function import Graph
    from faultrecon.io.door import library, load, save
    from faultrecon.io.library import library_names
    from faultrecon.io.logs import Log, read_log, write_log
    from faultrecon.io.playback import reconstruct, replay
    from faultrecon.io.watched import watch
    from faultrecon.methods.registry import cite, list_methods
    from faultrecon.plant.derive import discretised, equilibrium, linearise, linearised
    from faultrecon.plant.fault import Disturbance, FaultChannel
    from faultrecon.plant.lipschitz import Lipschitz
    from faultrecon.plant.plant import OperatingPoint, Plant
    from faultrecon.plant.signals import Channels, Noise, Signals
    from faultrecon.runtime.estimator import Estimator
    from faultrecon.runtime.intake import Intake
    from faultrecon.runtime.monitor import Monitor
    from faultrecon.simulation.metrics import score
    from faultrecon.simulation.run import Run, simulate
    from faultrecon.simulation.scenario import Scenario
    from faultrecon.simulation.study import study
    from faultrecon.simulation.trial import trial
    from faultrecon.synthesis.bank import Bank, bank
    from faultrecon.synthesis.pipeline import optimum
    from faultrecon.synthesis.result import Design


def __getattr__(name: str) -> Any:
    if name not in _DOOR:
        raise AttributeError(f"module 'faultrecon' has no attribute '{name}'")
    value = getattr(import_module(_DOOR[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
