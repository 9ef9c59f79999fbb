# SPDX-License-Identifier: BSD-3-Clause
"""Fit the two-state reactor to the healthy part of the recorded logs and write plant files and `fit.json`.

    python examples/activated_sludge/fit.py            # needs the logs and scipy, not the simulator

    nitrifiers' = (g - D) nitrifiers + D n_in,  g = a S/(S + b)
    ammonium'   = -c g nitrifiers + D (feed + rho - S),  S = ammonium

c, b and rho are fitted to the sensor itself by least squares on the simulated reading.  a and n_in are not: with a
sensor for ammonium alone c a n_in is all that counts, so they are a choice of unit (ASM1's growth rate, a round
number).
rho gathers what heterotrophs release and take up in the tank.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

FITTED, HELD_OUT = (24.0, 144.0), (144.0, 168.0)  # h, all before the fault
DAY = 24.0
A, IN = 0.5 / 24.0, 130.0  # 1/h, g COD/m3
NAMES, FIRST_GUESS = ("c", "b", "rho"), (4.5, 0.5, 0.5)
NOISE, HOLD = 0.1, 1.0 / 12.0  # g N/m3; h
BIOMASS = 0.04  # of the nitrifiers: what sludge in such tanks varies by within days
SEEN = 10 * NOISE  # g N/m3: a reading below it tells its gain to no better than a tenth
ROOM = 0.1  # by which the box of the certificates exceeds what the healthy part showed


def simulated(theta, log):
    """Ammonium (N,) by the model in open loop: inputs on straight lines, four-stage Runge-Kutta."""
    c, b, rho = theta
    D, s = log["dilution"], log["feed_ammonium"]
    steps, out = np.diff(log["t"]), np.empty(len(D))
    x = np.array([IN, log["ammonium"][0]])

    def rate(x, D, s):
        g = A * x[1] / (x[1] + b)
        return np.array([(g - D) * x[0] + D * IN, -c * g * x[0] + D * (s + rho - x[1])])

    for k, h in enumerate((*steps, 0.0)):
        out[k] = x[1]
        if h:
            Dm, sm = (D[k] + D[k + 1]) / 2, (s[k] + s[k + 1]) / 2
            k1 = rate(x, D[k], s[k])
            k2 = rate(x + h / 2 * k1, Dm, sm)
            k3 = rate(x + h / 2 * k2, Dm, sm)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, D[k + 1], s[k + 1]))
    return out


def fitted(log):
    """Constants and their covariance, which counts whole days as the independent pieces of what the model misses."""
    healthy = {name: v[log["t"] < HELD_OUT[1]] for name, v in log.items()}
    used = (healthy["t"] >= FITTED[0]) & (healthy["t"] < FITTED[1])
    found = least_squares(lambda th: (simulated(th, healthy) - healthy["ammonium"])[used], FIRST_GUESS, x_scale="jac")
    day = (healthy["t"][used] // DAY).astype(int)
    scores = np.array([found.jac[day == k].T @ found.fun[day == k] for k in np.unique(day)])
    inverse, m = np.linalg.inv(found.jac.T @ found.jac), len(scores)
    covariance = m / (m - 1) * inverse @ scores.T @ scores @ inverse
    return found.x, covariance, simulated(found.x, healthy) - healthy["ammonium"], healthy


def box(healthy):
    """What the healthy part showed, with room around it; ammonium not below what its sensor tells its gain at."""

    def ends(values):
        low, high = np.quantile(values, (0.001, 0.999))
        return [float(f"{low * (1 - ROOM):.4g}"), float(f"{high * (1 + ROOM):.4g}")]

    found = {name: ends(healthy[name]) for name in ("dilution", "feed_ammonium", "ammonium")}
    return found | {"ammonium": [max(found["ammonium"][0], SEEN), found["ammonium"][1]]}


PLANT = """# SPDX-License-Identifier: BSD-3-Clause
schema = 1
name   = "{title} of BSM1, two states, with a fouling ammonium sensor"
source = "fitted to 5 healthy days of a recorded run of bsm2-python by examples/activated_sludge/fit.py; time in hours"

[signals]
x = ["nitrifiers [g/m3]", "substrate [g/m3]"]
u = ["dilution [1/h]", "feed_ammonium [g/m3]"]
y = ["ammonium [g/m3]"]
range = {{ nitrifiers = 10.0, substrate = {mean:.3g}, dilution = 0.3, feed_ammonium = 4.0, ammonium = {mean:.3g} }}

[noise]
hold = {hold:.6g}
sd   = {{ ammonium = {noise:g} }}

[operating_point]                         # equilibrium at the mean dilution rate and feed
x = {{ nitrifiers = {x[0]!r}, substrate = {x[1]!r} }}
u = {{ dilution = {u[0]:g}, feed_ammonium = {u[1]:g} }}
y = {{ ammonium = {x[1]!r} }}

[matrices]                                # everything is in the nonlinear part: x' = phi(x, u)
A = [[0.0, 0.0], [0.0, 0.0]]
B = [[0.0, 0.0], [0.0, 0.0]]
C = {{ select = ["substrate"] }}

[nonlinearity]
into = ["nitrifiers", "substrate"]
phi  = [
  "(a*substrate/(substrate + b) - dilution)*nitrifiers + dilution*n_in",
  "-c*a*substrate/(substrate + b)*nitrifiers + (feed_ammonium + rho - substrate)*dilution",
]
constants = {{ a = {a!r}, b = {b:.6g}, c = {c:.6g}, n_in = {n_in:g}, rho = {rho:.6g} }}
domain    = {{ nitrifiers = [0, 400], substrate = [0, 60], dilution = [0, 10], feed_ammonium = [0, 60] }}
lipschitz = "derive"

[polytopic]                               # x' = A(z) x + B(z) u
premises  = {{ z1 = "-dilution", z2 = "a*nitrifiers/(substrate + b)" }}
A         = [["z1", "z2"], [0, "z1 - c*z2"]]
B         = [["n_in", 0], ["rho", "-z1"]]
box       = {{ nitrifiers = [{n_low:.4g}, {n_high:.4g}], substrate = {S}, dilution = {D}, feed_ammonium = {feed} }}
faults    = {{ fouling = [-0.5, 0.05] }}
constants = {{ a = {a!r}, b = {b:.6g}, c = {c:.6g}, n_in = {n_in:g}, rho = {rho:.6g} }}

[polytopic.slope]                         # df/dx in premises of its own
premises = {{ growth = "a*substrate/(substrate + b)", h = "a*b*nitrifiers/(substrate + b)**2", rate = "dilution" }}
J        = [["growth - rate", "h"], ["-c*growth", "-c*h - rate"]]

[[disturbance]]
name = "nitrifiers that come in"
into = {{ nitrifiers = 1.0 }}
role = "noise"
size = {biomass:.3g}

[[disturbance]]
name = "ammonium that the model misses"
into = {{ substrate = 1.0 }}
role = "noise"
size = {missed:.3g}

[[fault]]
name   = "fouling"
sensor = "ammonium"
effect = "multiplicative"
size   = 0.5
rate   = 0.03
"""


def equilibrium(theta, D, s):
    """Nitrifiers and ammonium at rest, by Newton's method from the feed."""
    c, b, rho = theta
    x = np.array([IN, max(s, 1.0)])
    for _ in range(50):
        g, slope = A * x[1] / (x[1] + b), A * b / (x[1] + b) ** 2
        rate = np.array([(g - D) * x[0] + D * IN, -c * g * x[0] + D * (s + rho - x[1])])
        J = np.array([[g - D, slope * x[0]], [-c * g, -c * slope * x[0] - D]])
        x = x - np.linalg.solve(J, rate)
    return x


def plant_text(tank, theta, residual, healthy):
    """The plant file of one tank.  residual: what the model misses on the fitted part, sensor noise included."""
    D, s = float(f"{healthy['dilution'].mean():.4g}"), float(f"{healthy['feed_ammonium'].mean():.4g}")
    ends, x = box(healthy), equilibrium(theta, D, s)
    structure = np.sqrt(max(np.mean(residual**2) - NOISE**2, (0.1 * NOISE) ** 2))
    return PLANT.format(
        title=tank.replace("_", " ").replace("tank", "aerated tank"), mean=healthy["ammonium"].mean(), hold=HOLD,
        noise=NOISE, x=[float(v) for v in x], u=(D, s), a=A, b=theta[1], c=theta[0], rho=theta[2], n_in=IN,
        n_low=IN * (1 - 3 * BIOMASS), n_high=IN * (1 + 3 * BIOMASS), S=ends["ammonium"], D=ends["dilution"],
        feed=ends["feed_ammonium"],
        # White noise of intensity s sqrt(2 D) makes a state that forgets at the rate D deviate by s.
        biomass=BIOMASS * IN * np.sqrt(2 * D), missed=structure * np.sqrt(2 * D),
    )  # fmt: skip


def main():
    """Fit every tank in the folder given by --data."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("src/faultrecon/data/activated_sludge"))
    given, found = parser.parse_args(), {}
    for path in sorted(given.data.glob("*_tank.csv")):
        with path.open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
        log = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
        theta, covariance, residual, healthy = fitted(log)
        fit = (healthy["t"] >= FITTED[0]) & (healthy["t"] < FITTED[1])
        held = healthy["t"] >= HELD_OUT[0]
        text = plant_text(path.stem, theta, residual[fit], healthy)
        path.with_suffix(".toml").write_text(text, encoding="utf-8", newline="\n")
        found[path.stem] = {
            "constants": dict(zip(NAMES, (float(f"{v:.6g}") for v in theta), strict=True)),
            "covariance": [[float(f"{v:.4g}") for v in row] for row in covariance],
            "residual_rms_fitted": float(f"{np.sqrt(np.mean(residual[fit] ** 2)):.4g}"),
            "residual_rms_held_out": float(f"{np.sqrt(np.mean(residual[held] ** 2)):.4g}"),
        }
    about = {"script": "examples/activated_sludge/fit.py", "fitted_h": FITTED, "held_out_h": HELD_OUT,
             "independent_pieces": "days"}  # fmt: skip
    (given.data / "fit.json").write_text(json.dumps(about | found, indent=1) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
