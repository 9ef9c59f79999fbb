# SPDX-License-Identifier: BSD-3-Clause
"""JSBSim's F-16 with its flight control taken out: load, trim, place, read, and linearise by central differences.

The model's own flight control hides the airframe, so it is cut out of a copy of the model file: surfaces are set
directly, flaps stay in.  All four tanks are full, the two under the wings included.  That puts the centre of gravity
aft of the reference point of the aerodynamic data, and the airframe is unstable in pitch.
"""

import re
from pathlib import Path

import jsbsim
import numpy as np
from scipy.optimize import fsolve

FT = 0.3048  # metres in a foot
ALTITUDE_FT, SPEED = 5_000, 190.0  # ft, m/s true; Mach 0.57, below the Mach effects of the tables
FUEL_LB = (3486, 3486, 2991, 2991)  # every tank full
STEP = 0.01  # s, step of the simulator
N2_IDLE = 53.0  # %, core speed at closed throttle, from F100-PW-229.xml

# name: (unit, expected deviation from the operating point)
STATES = {
    "V": ("m/s", 6.0), "alpha": ("rad", 0.04), "beta": ("rad", 0.02),
    "p": ("rad/s", 0.1), "q": ("rad/s", 0.05), "r": ("rad/s", 0.03),
    "phi": ("rad", 0.1), "theta": ("rad", 0.1),
}  # fmt: skip
# Inputs are what the airframe feels, surfaces after their actuators; positive elevator pitches down.
INPUTS = {"n2": ("%", 2.0), "elevator": ("rad", 0.03), "aileron": ("rad", 0.02), "rudder": ("rad", 0.02)}
BARE = """<flight_control name="none: surfaces are set from outside">
  <property>fcs/flaperon-mix-rad</property><property>fcs/lef-pos-rad</property><property>fcs/aileron-pos-rad</property>
</flight_control>"""


def load(folder):
    """A fresh executive with the bare airframe, made from a copy of the shipped model."""
    root = Path(jsbsim.get_default_root_dir())
    model = Path(folder) / "f16" / "f16.xml"
    if not model.exists():
        text = (root / "aircraft" / "f16" / "f16.xml").read_text()
        for part in ("flight_control", "external_reactions"):  # hook and pushback tug go with their controls
            text, found = re.subn(rf"<{part}\b.*?</{part}>", BARE * (part == "flight_control"), text, flags=re.S)
            if found != 1:
                raise RuntimeError(f"f16.xml has {found} <{part}> sections, not one: another version of the model")
        text = re.sub(r'<system file="pushback">.*?</system>|<system file="hook"/>', "", text, flags=re.S)
        model.parent.mkdir(parents=True)
        model.write_text(text)
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    fdm.load_model_with_paths("f16", str(folder), str(root / "engine"), str(root / "systems"))
    fdm.set_dt(STEP)
    return fdm


def command(fdm, u):
    """Set the surfaces, and the throttle that holds the core speed."""
    fdm["fcs/throttle-cmd-norm"] = (u[0] - N2_IDLE) / (100.0 - N2_IDLE)
    for name, angle in zip(("elevator", "aileron", "rudder"), u[1:], strict=True):
        fdm[f"fcs/{name}-pos-rad"] = angle


def place(fdm, x, u, gust=(0.0, 0.0)):
    """Put the aircraft at state x with inputs u in air moving with `gust` (headwind, up; m/s), time standing still."""
    V, alpha, beta, p, q, r, phi, theta = x
    fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = phi, theta, 0.0  # north on the equator
    fdm["ic/u-fps"] = V * np.cos(alpha) * np.cos(beta) / FT
    fdm["ic/v-fps"] = V * np.sin(beta) / FT
    fdm["ic/w-fps"] = V * np.sin(alpha) * np.cos(beta) / FT
    fdm["ic/p-rad_sec"], fdm["ic/q-rad_sec"], fdm["ic/r-rad_sec"] = p, q, r
    fdm["ic/h-sl-ft"] = ALTITUDE_FT
    fdm["gear/gear-cmd-norm"] = fdm["gear/gear-pos-norm"] = 0.0
    for tank, fuel in enumerate(FUEL_LB):
        fdm[f"propulsion/tank[{tank}]/contents-lbs"] = fuel
    fdm.run_ic()
    fdm["propulsion/set-running"] = -1
    fdm["propulsion/fuel_freeze"] = 1  # constant mass: the linear model has no fuel state
    fdm["propulsion/engine/n2"] = u[0]
    command(fdm, u)
    for axis, speed in zip(("north", "down"), gust, strict=True):
        fdm[f"atmosphere/wind-{axis}-fps"] = -speed / FT
    fdm.suspend_integration()
    for _ in range(8):  # engine and accelerations settle over a few passes
        fdm.run()


def velocity(fdm):
    """Inertial velocity along the body axes, m/s."""
    return np.array([fdm[f"velocities/{c}-fps"] for c in "uvw"]) * FT


def state(fdm):
    """x in the order of STATES: inertial speed, inertial flow angles, body rates, attitude."""
    ub, vb, wb = velocity(fdm)
    V = np.sqrt(ub**2 + vb**2 + wb**2)
    rates = [fdm[f"velocities/{c}-rad_sec"] for c in "pqr"]
    return np.array([V, np.arctan2(wb, ub), np.arcsin(vb / V), *rates,
                     fdm["attitude/phi-rad"], fdm["attitude/theta-rad"]])  # fmt: skip


def state_rate(fdm):
    """dx/dt from the simulator's body accelerations."""
    (ub, vb, wb), V = velocity(fdm), state(fdm)[0]
    ud, vd, wd = (fdm[f"accelerations/{c}dot-ft_sec2"] * FT for c in "uvw")
    Vd = (ub * ud + vb * vd + wb * wd) / V
    plane2 = ub**2 + wb**2
    return np.array([Vd, (ub * wd - wb * ud) / plane2, (vd * V - vb * Vd) / (V * np.sqrt(plane2)),
                     *(fdm[f"accelerations/{c}dot-rad_sec2"] for c in "pqr"),
                     fdm["velocities/phidot-rad_sec"], fdm["velocities/thetadot-rad_sec"]])  # fmt: skip


def rate_at(fdm, x, u, gust=(0.0, 0.0)):
    """dx/dt at one point."""
    place(fdm, x, u, gust)
    rate = state_rate(fdm)
    fdm.resume_integration()
    return rate


def trim(fdm):
    """Straight and level at SPEED: angle of attack, elevator and core speed by Newton's method; returns x0, u0.

    JSBSim's own trim works through the controls that were cut out.
    """

    def point(z):
        alpha, elevator, n2 = z[0], z[1], 100.0 * z[2]
        return np.array([SPEED, alpha, 0, 0, 0, 0, 0, alpha]), np.array([n2, elevator, 0, 0])

    z, _, ok, why = fsolve(
        lambda z: rate_at(fdm, *point(z))[[0, 1, 4]], [0.05, 0.0, 0.8], full_output=True, epsfcn=1e-8
    )
    if ok != 1:
        raise RuntimeError(f"no trim: {why}")
    return point(z)


def linearise(fdm, x0, u0):
    """Central differences of dx/dt over state, input and gust (headwind, up); returns A, B, E_w.

    Couplings that move a state by less than 0.1 % of its range per second are set to zero: they are the Earth's
    rotation and rounding.  Nine decimals are what the steps resolve.
    """
    effect = np.array([size for _, size in STATES.values()])

    def slope(steps, cause, move):
        columns = [(move(d) - move(-d)) / (2 * h) for h, d in zip(steps, np.diag(steps), strict=True)]
        J = np.array(columns).T
        return np.where(abs(J) * np.array(cause) < 1e-3 * effect[:, None], 0.0, J.round(9))

    # Steps stay inside one cell of the tables, which are piecewise linear with breaks each 0.087 rad of alpha.
    A = slope([0.5] + 7 * [0.005], effect, lambda d: rate_at(fdm, x0 + d, u0))
    B = slope([0.5] + 3 * [0.005], [size for _, size in INPUTS.values()], lambda d: rate_at(fdm, x0, u0 + d))
    E_w = slope([0.5, 0.5], [1.0, 1.0], lambda d: rate_at(fdm, x0, u0, d))
    return A, B, E_w


def aft_of_reference(fdm):
    """How far the centre of gravity lies aft of the reference point of the aerodynamic data, m; and the mass, kg."""
    return (fdm["inertia/cg-x-in"] - -189.5) * FT / 12, fdm["inertia/weight-lbs"] * 0.45359237
