# SPDX-License-Identifier: BSD-3-Clause
"""A Kalman filter in logarithms, where a lost gain adds:  log y = log h + log(1 + f).

    ξ = log x for a state that a faulty sensor shows alone, log(1 + f) for its gain, and whatever else as it is

With them the faulty sensor is exactly linear, y = log x + log(1 + f), at every level of the state: what an extended
filter loses by linearising the product f h it does not lose here.  Mean and flow are those of the plant, the covariance
is that of ξ.  Noise of the sensor, drives and the start are taken over to first order, sd/ŷ and so on, so that the
filter has the declared tuning; the logarithm keeps the state and the gain positive.

For positive outputs alone.  A sample at or near zero has no logarithm: the filter then holds what it has.  With the
gate of `kalman_filter`, four standard deviations unless asked otherwise, it follows jumps at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import Finding
from faultrecon.methods.kalman_filter import KalmanFilter
from faultrecon.methods.kalman_steps import Extended, Tuning, scaled, scaling_faults
from faultrecon.methods.papers import BEZZAOUCHA_2013
from faultrecon.methods.scaled_conditions import SEE, shared_findings
from faultrecon.methods.scaled_sensors import readings
from faultrecon.plant.plant import Plant

Array = NDArray[np.float64]

NEAR = 3.0
"""Standard deviations of the noise: a reading below has a logarithm that is mostly noise, or none."""
ROUNDING = 2.0**-40


class LogEkf(KalmanFilter):
    """The extended filter for log y, with a jump gate."""

    name = "log-ekf"
    summary = "baseline: extended Kalman filter in logarithms for positive sensors that lose gain, with a jump gate"
    paper = BEZZAOUCHA_2013
    usual_gate = 16.0

    def assumptions(self, plant: Plant) -> list[Finding]:
        """Those of augmented-ekf, at least one multiplicative fault, and faulty sensors that read above zero."""
        if plant.faults and not scaling_faults(plant).any():
            return [_nothing_scales(plant)]
        return super().assumptions(plant)

    def scale_findings(self, plant: Plant) -> list[Finding]:
        """Each gain on a sensor of its own, which reads above zero in the box, or at the operating point."""
        found = super().scale_findings(plant) or shared_findings(plant)
        return found or _sign_findings(plant)

    def steps(self, plant: Plant, T: float, tuning: Tuning) -> Extended:
        """By slopes, in logarithms."""
        return Logarithmic(plant, T, tuning)


class Logarithmic(Extended):
    """Steps of the extended filter with P of ξ; `stretch` is dξ/ds."""

    @property
    def _near(self) -> Array:
        """Readings too near to zero for a logarithm, (p,)."""
        return NEAR * np.sqrt(self.tuning.R)

    @property
    def _alone(self) -> dict[int, tuple[float, float]]:
        """States that a faulty sensor shows alone, y = c x: c, and how near to zero the state may come."""
        plant, found = self.plant, {}
        for i in np.flatnonzero(scaled(plant)):
            at = np.flatnonzero(plant.C[i])
            if len(at) == 1 and not plant.D[i].any():
                k, c = int(at[0]), float(plant.C[i, at[0]])
                offset = plant.point.y[i] - c * plant.point.x[k]
                if c > 0 and abs(offset) <= ROUNDING * abs(plant.point.y[i]):
                    found[k] = c, float(self._near[i]) / c
        return found

    def stretch(self, s: Any) -> Any:
        """dξ/ds, (N, 1)."""
        import casadi as ca

        plant, n, out = self.plant, self.plant.n, [ca.SX(1.0)] * len(self.tuning.Q)
        for k, (_, near) in self._alone.items():
            out[k] = 1.0 / ca.fmax(float(plant.point.x[k]) + s[k], near)
        for j in np.flatnonzero(scaling_faults(plant)):
            c = self._coefficient(int(j))
            out[n + j] = c / (1.0 + c * s[n + j])
        return ca.vertcat(*out)

    def _coefficient(self, j: int) -> float:
        """Of fault j on its sensor."""
        return float(self.plant.F_f[np.argmax(np.abs(self.plant.F_f[:, j])), j])

    def start(self) -> Array:
        """P0 in ξ, at the operating point."""
        import casadi as ca

        by = np.array(ca.evalf(self.stretch(ca.SX.zeros(len(self.tuning.Q), 1)))).ravel()
        return self.tuning.P0 * np.outer(by, by)

    def drive(self, s: Any) -> Any:
        """Q in ξ, at s."""
        import casadi as ca

        by = self.stretch(s)
        return ca.DM(self.tuning.Q) * ca.mtimes(by, by.T)

    def jumps(self, i: int, s: Any) -> Any:
        """In ξ, at s."""
        import casadi as ca

        found, by = super().jumps(i, s), self.stretch(s)
        return None if found is None else found * ca.mtimes(by, by.T)

    def pushed(self, s: Any, by: Any) -> Any:
        """x e^δ and (1 + f) e^δ where ξ is a logarithm, else x + δ."""
        import casadi as ca

        plant, n, out = self.plant, self.plant.n, ca.vertsplit(s + by)
        for k in self._alone:
            x0 = float(plant.point.x[k])
            out[k] = (x0 + s[k]) * ca.exp(by[k]) - x0
        for j in np.flatnonzero(scaling_faults(plant)):
            c = self._coefficient(int(j))
            out[n + j] = ((1.0 + c * s[n + j]) * ca.exp(by[n + j]) - 1.0) / c
        return ca.vertcat(*out)

    def corrected_by(self, i: int, s: Any, P: Any, direct: Any, y: Any, seen: Any) -> tuple[Any, Any]:
        """A sample of a faulty sensor at or near zero corrects nothing, nor one that is expected there."""
        import casadi as ca

        if scaled(self.plant)[i]:
            h, near = self.healthy(i, s, direct), float(self._near[i])
            least = ca.fmin(ca.fmin(h, h * self.gain(i, s)), self._absolute(i, direct, y))
            seen = ca.if_else(least > near, seen, 0.0)
        return super().corrected_by(i, s, P, direct, y, seen)

    def _absolute(self, i: int, direct: Any, y: Any) -> Any:
        return y + direct[i] + float(self.plant.point.y[i])

    def innovation(self, i: int, s: Any, P: Any, direct: Any, y: Any) -> tuple[Any, Any, Any]:
        """log y - log h - log(1 + f) of a faulty sensor with the variance (sd/ŷ)²; of a healthy one y - ŷ."""
        import casadi as ca

        at, near = ca.SX.sym("at", s.numel()), float(self._near[i])
        whole, R = self.shown(i, at, direct), float(self.tuning.R[i])
        off, variance = y - whole, ca.SX(R)
        if scaled(self.plant)[i]:
            expected = ca.fmax(self._absolute(i, direct, whole), near)
            off, variance = ca.log(ca.fmax(self._absolute(i, direct, y), near)) - ca.log(expected), R / expected**2
        c = -ca.jacobian(off, at) / self.stretch(at).T
        off, variance, c = ca.substitute([off, variance, c], [at], [s])
        Pc = ca.mtimes(P, c.T)
        return off, Pc, ca.mtimes(c, Pc) + variance

    def carried(self, s: Any, P: Any, u: Any, y: Any, t: Any) -> tuple[Any, Any]:
        """The mean by the flow of the plant, the covariance by its slope in ξ."""
        import casadi as ca

        before = ca.diag(1.0 / self.stretch(s))
        here, P = super().carried(s, ca.mtimes(ca.mtimes(before, P), before), u, y, t)
        after = ca.diag(self.stretch(here))
        return here, ca.mtimes(ca.mtimes(after, P), after)


def _nothing_scales(plant: Plant) -> Finding:
    return Finding(
        f"no fault of {plant.name} multiplies what a sensor shows",
        why="the logarithm turns a product into a sum, and there is none",
        evidence={"faults": [f.name for f in plant.faults]},
        remedies=("use augmented-ekf", 'declare effect = "multiplicative" if the sensor loses gain'),
        see=SEE,
    )


def _sign_findings(plant: Plant) -> list[Finding]:
    """Sensors that lose gain and may read zero or less."""
    ends = [(y, y) for y in plant.point.y] if plant.polytopic is None else readings(plant)
    for i, (low, high) in enumerate(ends):
        if scaled(plant)[i] and low <= 0.0:
            name, where = plant.signals.y.names[i], "operating point" if plant.polytopic is None else "box"
            return [
                Finding(
                    f"{name} is not always positive",
                    why=f"at the {where} it reads from {low:.4g} to {high:.4g}, and log {name} is what the filter is about",
                    evidence={"sensor": name, "low": low, "high": high},
                    remedies=(
                        "use augmented-ekf",
                        "shrink the box of [polytopic]",
                        "choose the unit without an offset",
                    ),
                    see=SEE,
                )
            ]
    return []
