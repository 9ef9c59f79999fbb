# SPDX-License-Identifier: BSD-3-Clause
"""What most people would try first: an extended Kalman filter on [x; f], with the model of the plant file.

The fault is a random walk whose steps have the standard deviation rate times sample time; each disturbance is white, of
its declared size and held for `memory` seconds.  Nothing is proved about it.
"""

import numpy as np


def follow(plant, log, memory=0.1):
    """The fault as the filter sees it, (N,).  plant: one sensor fault, phi of the states; log: regular samples."""
    n, step, fault, term = plant.n, float(np.median(np.diff(log.t))), plant.faults[0], plant.nonlinearity
    A, B, C = np.zeros((n + 1, n + 1)), np.vstack([plant.B, 0.0 * plant.B[:1]]), np.hstack([plant.C, plant.F_f])
    A[:n, :n] = plant.A
    G, H = np.vstack([plant.G, 0.0 * plant.G[:1]]), np.hstack([plant.H, np.zeros((len(plant.H), 1))])
    slope, idle = term.phi.jacobian("x"), (np.zeros(plant.B.shape[1]), [0.0])
    E = plant.E_w * [d.size for d in plant.attenuated]
    Q = np.zeros_like(A)
    Q[:n, :n], Q[n, n] = E @ E.T * memory * step, (fault.rate * step) ** 2
    R, eye = np.diag(np.square(plant.noise.sd)), np.eye(n + 1)
    z, P, found = np.zeros(n + 1), np.diag([1.0] * n + [fault.size**2]), []
    for k, y in enumerate(log.y):
        K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
        z, left = z + K @ (y - C @ z), eye - K @ C
        P = left @ P @ left.T + K @ R @ K.T  # Joseph: stays symmetric, or rounding lets the filter diverge
        found.append(z[n])
        u = log.u[k : k + 2].mean(axis=0)
        F = A + G @ slope(H @ z, *idle) @ H  # two terms of the exponential: the plant turns by 0.04 in one sample
        z = z + step * (eye + step / 2 * F) @ (A @ z + B @ u + G @ term.phi(H @ z, *idle))
        step_map = eye + step * F + step**2 / 2 * F @ F
        P = step_map @ P @ step_map.T + Q
    return np.array(found)
