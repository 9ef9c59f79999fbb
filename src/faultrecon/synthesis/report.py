# SPDX-License-Identifier: BSD-3-Clause
"""What a design reports about itself: levels, gains, poles, steps, noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError
from faultrecon.graph.observer import Observer
from faultrecon.numerics.discretise import discrete_covariance, held_noise_covariance, rk4_polynomial_limit
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DesignReport:
    """Numbers about a design, all measured on the gains that ship.

    poles in rad/s; largest_step in s (classical Runge-Kutta, linear part; of a sampled observer its sample time);
    noise_sd: standard deviation of each reconstructed fault that the declared sensor noise alone causes in the linear
    part (None: no noise declared).
    """

    criterion: str
    backoff: float
    pole_bound: float | None
    bounded_optimum: float | None
    gain_norms: Mapping[str, float]
    fastest_pole: float
    slowest_pole: float
    largest_step: float
    noise_sd: Mapping[str, float] | None
    attempts: tuple[str, ...]
    seconds: float
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain values for files and `--json`; an unlimited step is None."""
        return {**self.__dict__, "gain_norms": dict(self.gain_norms), "attempts": list(self.attempts)} | {
            "noise_sd": None if self.noise_sd is None else dict(self.noise_sd),
            "notes": list(self.notes),
            "largest_step": self.largest_step if np.isfinite(self.largest_step) else None,
        }

    @staticmethod
    def from_dict(stored: Mapping[str, Any]) -> DesignReport:
        """The report that `as_dict` wrote.  Raises InputError on damage."""
        try:
            step = stored["largest_step"]
            for key in ("backoff", "fastest_pole", "slowest_pole", "seconds"):
                float(stored[key])
            lists = {k: tuple(stored[k]) for k in ("attempts", "notes")}
            return DesignReport(**{**stored, **lists, "largest_step": np.inf if step is None else float(step)})
        except (KeyError, TypeError, ValueError) as error:
            raise InputError("the stored report is damaged", why=f"{type(error).__name__}: {error}") from error


def fault_noise(plant: Plant, observer: Observer) -> dict[str, float] | None:
    """Standard deviation of each f̂ under the declared sensor noise, held per sample: f̂ = Cf z + Df v, linear part.

    Of a filter with a covariance it is that of the filter once the covariance has settled.
    """
    if plant.noise is None or np.any(np.real(observer.rates) >= 0):
        return None
    m = observer.inputs
    variances = np.square(plant.noise.sd)
    B, term = observer.B[:, m:], observer.nonlinear
    if (
        term is not None and term.direct is not None and not term.flat
    ):  # y may enter through the nonlinear part: to first order, at rest
        slope = term.phi.jacobian("x")(term.offset, observer.u0, [0.0])
        B = B + term.into @ slope @ term.direct[:, m:]
    if observer.sample_time is None:
        covariance = held_noise_covariance(observer.A, B, variances, plant.noise.hold)
    else:
        covariance = discrete_covariance(observer.A, (B * variances) @ B.T)
    # A sample is in y before it has moved the state, so at a sample instant the two parts are uncorrelated.
    Cf, direct = observer.Cf, observer.Df[:, m:] * np.sqrt(variances)
    if observer.readout is not None:
        slope = observer.readout.jacobian("f")(np.zeros(len(Cf)), observer.x0)
        Cf, direct = slope @ Cf, slope @ direct
    total = Cf @ covariance @ Cf.T + direct @ direct.T
    return {f.name: float(np.sqrt(max(v, 0.0))) for f, v in zip(plant.faults, np.diag(total), strict=True)}


def describe(plant: Plant, observer: Observer, gains: Mapping[str, Array], **known: Any) -> DesignReport:
    """The report of a design; `known` holds what the pipeline alone can tell."""
    poles = observer.rates
    return DesignReport(
        gain_norms={name: float(np.linalg.norm(value, 2)) if value.size else 0.0 for name, value in gains.items()},
        fastest_pole=float(np.abs(poles).max()),
        slowest_pole=float(np.abs(np.real(poles)).min()),
        largest_step=observer.sample_time or rk4_polynomial_limit(poles),
        noise_sd=fault_noise(plant, observer),
        **known,
    )
