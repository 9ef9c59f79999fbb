# SPDX-License-Identifier: BSD-3-Clause
"""How well anyone could reconstruct the faults of a plant, whatever the method and the solver."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from faultrecon.numerics.annihilator import annihilator, left_inverse
from faultrecon.numerics.hinf import Peak, estimator_floor
from faultrecon.plant.plant import Plant


@lru_cache(maxsize=16)
def reconstruction_floor(plant: Plant) -> Peak | None:
    """The gain from disturbances to reconstruction errors below which no linear estimator passing the faults can go.

    Both sides in declared sizes.  None where no bound of this kind applies: no sensor fault, an actuator fault, or no
    counted disturbance.  For a nonlinear plant it bounds what can be *guaranteed* for every φ within the Lipschitz
    bound, of which φ = 0 is one; for the φ of one plant alone a smaller gain may be possible.
    Source: [Khosrowjerdi 2011], re-derived; sup over frequency of |Y2 (I - Y1⁺ Y1)|.
    """
    if not plant.faults or any(f.site == "actuator" for f in plant.faults) or not plant.attenuated:
        return None
    letters = plant.letters()
    N, Fp = annihilator(plant.F_f), letters["V"] @ left_inverse(plant.F_f)
    B, E = plant.E_w @ letters["W"], plant.F_w @ letters["W"]
    peak = estimator_floor(plant.A, B, N @ plant.C, N @ E, Fp @ plant.C, Fp @ E)
    return peak if np.isfinite(peak.value) else Peak(float("inf"), peak.frequency)
