# SPDX-License-Identifier: BSD-3-Clause
"""A design: what comes out of synthesis, and what it says about itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.certificate import Certificate, Verification
from faultrecon.finding import InputError, did_you_mean
from faultrecon.graph.observer import Observer
from faultrecon.methods.registry import method as method_named
from faultrecon.plant.plant import Plant
from faultrecon.synthesis.certify import prove
from faultrecon.synthesis.report import DesignReport

if TYPE_CHECKING:
    from faultrecon.runtime.estimator import Estimator

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Design:
    """A plant, a method, the gains that ship, and what is proved about them.

    optimum: infimum of the level without a pole bound.  level: γ that the certificate claims (None: no certificate).
    floor: no linear estimator gets below it (None: not known).  gains: by the paper's letters, in the plant's units.
    """

    plant: Plant
    method: str
    gains: Mapping[str, Array]
    optimum: float | None
    level: float | None
    floor: float | None
    certificate: Certificate | None
    details: DesignReport

    @cached_property
    def observer(self) -> Observer:
        """The executable equations."""
        return method_named(self.method).observer(self.plant, self.gains)

    @cached_property
    def verification(self) -> Verification | None:
        """The certificate's proof, by exact integers; computed once."""
        return None if self.certificate is None else prove(self.certificate)

    def estimator(self, sample_time: float | None = None, **options: Any) -> Estimator:
        """The observer at run time: pure `init` and `step`.  sample_time in s: by default that of a sampled
        observer, else the noise's hold time.

        options: `hold` ("left", "midpoint", "linear"), `scheme` ("auto", "zoh", "rk4"; "implicit" and "explicit" for
        sliding modes), `engine` ("auto", "casadi", "numba"), and for sliding modes `bound` ρ and `layer` δ of the
        injection, see `Estimator.build`.  `estimator.warm()` compiles ahead for fast single steps.
        """
        from faultrecon.runtime.estimator import Estimator
        from faultrecon.runtime.filling import Prediction

        known = [k for k, p in signature(Estimator.build).parameters.items() if p.kind is p.KEYWORD_ONLY]
        known.remove("prediction")  # it is the plant's
        for name in options:
            if name not in known:
                raise InputError(f"an estimator has no option '{name}'", why=did_you_mean(name, known))
        prediction = Prediction(self.plant.C, self.plant.D)
        return Estimator.build(self.observer, self._sample_time(sample_time), prediction=prediction, **options)

    def _sample_time(self, given: float | None) -> float:
        own = given if given is not None else self.observer.sample_time
        if own is not None:
            return own
        if self.plant.noise is None:
            raise InputError("no sample time is known", remedies=("pass sample_time=... in seconds",))
        return self.plant.noise.hold

    def as_dict(self) -> dict[str, Any]:
        """A summary as plain values, for `--json`."""
        found = self.verification
        return {
            "plant": self.plant.name,
            "method": self.method,
            "faults": [f.name for f in self.plant.faults],
            "optimum": self.optimum,
            "level": self.level,
            "floor": self.floor,
            "verdict": None if found is None else found.verdict,
            "certificate": None if found is None else found.as_dict(),
            "details": self.details.as_dict(),
        }

    def report(self) -> str:
        """The design in a dozen lines of text."""
        d, found = self.details, self.verification
        lines = [f"{self.method} for {self.plant.name}: faults {', '.join(f.name for f in self.plant.faults)}"]
        if self.level is not None:
            floor = "not known" if self.floor is None else f"{self.floor:.6g}"
            lines.append(f"  γ shipped {self.level:.6g}, optimum {self.optimum:.6g}, floor {floor}")
        if d.pole_bound is not None and d.bounded_optimum is not None:
            lines.append(f"  optimum {d.bounded_optimum:.6g} with poles to the right of -{d.pole_bound:.4g} rad/s")
        lines.append(f"  chosen by: {d.criterion}")
        if d.gain_norms:
            lines.append("  gains: " + ", ".join(f"|{k}| = {v:.4g}" for k, v in d.gain_norms.items()))
        lines.append(f"  poles: fastest {d.fastest_pole:.4g} rad/s, slowest decay {d.slowest_pole:.4g} 1/s")
        sampled = self.observer.sample_time is not None
        lines.append(f"  {'sample time' if sampled else 'largest stable Runge-Kutta step'}: {d.largest_step:.4g} s")
        if d.noise_sd is not None:
            units = dict(zip(self.plant.signals.y.names, self.plant.signals.y.units, strict=True))
            for fault in self.plant.faults:
                sensor, coefficient = next(iter(fault.on.items()))
                plain = coefficient == 1.0 and fault.effect == "additive"  # one that multiplies has no unit
                unit = f" {units[sensor]}" if plain and units.get(sensor) else ""
                lines.append(
                    f"  noise in {fault.name}: {d.noise_sd[fault.name]:.4g}{unit} (standard deviation, linear part)"
                )
        lines += [f"  note: {note}" for note in d.notes]
        if found is None or self.certificate is None:
            lines.append("  certificate: none; nothing is claimed")
        else:
            lines.append(f"  certificate: {found.verdict}; {self.certificate.claim}")
            lines.append(f"  scope: {self.certificate.scope}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        level = "no certificate" if self.level is None else f"γ = {self.level:.6g}"
        return f"Design({self.method!r} for {self.plant.name!r}: {level})"
