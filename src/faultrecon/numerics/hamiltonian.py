# SPDX-License-Identifier: BSD-3-Clause
"""The stable invariant subspace of a Hamiltonian matrix, or the frequencies that stand in its way.

Everything a Riccati equation can tell is in here: with U = [U1; U2] spanning the stable subspace of
H = [F, Q; -S, -F'], X = U2 U1^-1 solves F'X + X F + X Q X + S = 0 with F + Q X stable, and P = X^-1 exists when U2 is
invertible.  U is orthonormal, so neither inverse is needed to ask whether X >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.numerics.scaling import spectral_norm

Array = NDArray[Any]

AXIS_TOLERANCE = 1e-11
"""Relative to the largest eigenvalue: eigenvalues nearer to the imaginary axis than this belong to it.  Counting n
stable eigenvalues is not enough: a pair on the axis, split by rounding, passes that count at a level too small."""


POSITIVE = 1e-11
"""A sine of twice the angle of X above minus this counts as not negative, H being of moderate size."""


@dataclass(frozen=True, slots=True)
class StableSubspace:
    """[U1; U2] (2n, n) orthonormal with H [U1; U2] = [U1; U2] T, T quasi-triangular and stable.

    The Hamiltonian was scaled by `unit`: X = unit * U2 U1^-1.  rounding: eps |H|.
    """

    U1: Array
    U2: Array
    T: Array
    unit: float
    rounding: float

    @property
    def slack(self) -> float:
        """How far below zero rounding may put a sine that is zero."""
        return max(POSITIVE, 10 * self.rounding)


def stable_subspace(F: Array, Q: Array, S: Array) -> StableSubspace | Array:
    """The stable subspace of [F, Q; -S, -F'], or the frequencies w >= 0 of its eigenvalues jw when there are some.

    F, Q, S: (n, n), Q and S symmetric.  An empty array means that no clean split was reached although no eigenvalue was
    found on the axis (the reordering failed, or the count of stable eigenvalues is not n).
    """
    from scipy.linalg import LinAlgError, get_lapack_funcs, schur

    n = F.shape[0]
    if not (np.isfinite(F).all() and np.isfinite(Q).all() and np.isfinite(S).all()):
        return np.zeros(0)
    size = spectral_norm(S), spectral_norm(Q)
    unit = float(np.exp2(np.rint(0.5 * np.log2(size[0] / size[1])))) if min(size) > 0 else 1.0
    H = np.block([[F, Q * unit], [-S / unit, -F.T]])
    if n == 0:
        return StableSubspace(H, H, H, 1.0, 0.0)
    try:
        T, U = schur(H)[:2]
    except (LinAlgError, ValueError):
        return np.zeros(0)
    real, imag = _diagonal_blocks(T)
    near = np.abs(real) <= AXIS_TOLERANCE * np.max(np.hypot(real, imag))
    if near.any():
        return np.unique(np.abs(imag[near]))
    stable = real < 0
    if int(stable.sum()) != n:
        return np.zeros(0)
    (trsen,) = get_lapack_funcs(("trsen",), (T,))  # without SciPy's Python callback per eigenvalue
    T, U, _, _, _, _, _, info = trsen(stable.astype(np.int32), T, U, job=b"N")
    if info != 0:
        return np.zeros(0)
    return StableSubspace(U[:n, :n], U[n:, :n], T[:n, :n], unit, float(np.finfo(float).eps * np.linalg.norm(H)))


def _diagonal_blocks(T: Array) -> tuple[Array, Array]:
    """Real and imaginary parts of the eigenvalues of a real Schur form, in the order of its diagonal."""
    d, below, above = np.diag(T), np.append(np.diag(T, -1), 0.0), np.append(np.diag(T, 1), 0.0)
    w = np.sqrt(np.abs(below * above))
    imag = np.where(below != 0, w, 0.0)
    imag[1:] = np.where(below[:-1] != 0, w[:-1], imag[1:])
    return d, imag


def signs(subspace: StableSubspace) -> tuple[Array, Array]:
    """sin(2 t)/2 and directions Z for X = unit * tan(t): all >= 0 exactly when X >= 0 (inf included), none inverted.

    U1'U2 is symmetric for an exact subspace; its eigenvalues are cos t sin t and pass through 0 linearly both when an
    eigenvalue of X does and when it passes through infinity.
    """
    N = subspace.U1.T @ subspace.U2
    return np.linalg.eigh(0.5 * (N + N.T))
