# SPDX-License-Identifier: BSD-3-Clause
"""What users pick today: a Kalman filter in which faults are further states that walk at random.

Sampled, tuned from what the plant declares and from nothing else (see `kalman_steps.tuned`), without any guarantee.
Disturbances with role "decouple" are further states too; all others are white noise.  The estimate shown at a sample is
the prediction for it, from the samples before it, as that of euler-pi is for faults.  A fault may also take away the
gain of a sensor, which then shows (1 + f) h: f is a state like any other, and the sensor is no longer linear.
"""

from __future__ import annotations

from faultrecon.methods.kalman_filter import KalmanFilter
from faultrecon.methods.kalman_steps import Extended, Tuning, Unscented
from faultrecon.methods.papers import JAZWINSKI_1970, JULIER_2004
from faultrecon.plant.plant import Plant


class AugmentedEkf(KalmanFilter):
    """The extended filter: the covariance moves with the slope of one Runge-Kutta step at the estimate."""

    name = "augmented-ekf"
    summary = "baseline: extended Kalman filter, faults and decoupled disturbances as random walks; no guarantee"
    paper = JAZWINSKI_1970

    def steps(self, plant: Plant, T: float, tuning: Tuning) -> Extended:
        """By slopes."""
        return Extended(plant, T, tuning)


class AugmentedUkf(KalmanFilter):
    """The unscented filter: mean and covariance of points that each take the Runge-Kutta step."""

    name = "augmented-ukf"
    summary = "baseline: unscented Kalman filter, faults and decoupled disturbances as random walks; no guarantee"
    paper = JULIER_2004

    def steps(self, plant: Plant, T: float, tuning: Tuning) -> Extended:
        """By points."""
        return Unscented(plant, T, tuning)
