# SPDX-License-Identifier: BSD-3-Clause
"""Fly JSBSim's 737, linearise it, and record the logs behind the airliner example.

    python examples/airliner/record.py --out src/faultrecon/data/airliner

The truth plant is the nonlinear 737 that the `jsbsim` wheel brings along.  What is written is a linear plant
file for one cruise condition, ten short flights (healthy and with failing sensors, in calm air and in
gusts), and `provenance.json`, which says how every file came about and how far the linear model can be trusted.

The states are inertial.  Gusts then enter as velocities of the air: they act through the aerodynamics and
shift what the airspeed sensor and the vanes read, and nowhere does the derivative of a gust appear.
"""

import argparse
import json
import os
import platform
import re
import tempfile
from importlib.metadata import version
from pathlib import Path

import jsbsim
import numpy as np
import pandas as pd
from scipy.signal import lsim

FT = 0.3048  # metres in a foot
DEG = np.pi / 180
ALTITUDE_FT, CALIBRATED_KT = 20_000, 300
STEP = 0.01  # s, step of the simulator
HOLD = 0.02  # s, sample time of the logs and of their noise (50 Hz)
DURATION, ONSET = 60.0, 20.0  # s

# name: (unit, expected deviation from the operating point)
STATES = {
    "V": ("m/s", 6.0), "alpha": ("rad", 0.03), "beta": ("rad", 0.03),
    "p": ("rad/s", 0.2), "q": ("rad/s", 0.04), "r": ("rad/s", 0.04),
    "phi": ("rad", 0.25), "theta": ("rad", 0.06),
}  # fmt: skip
# The inputs are what the airframe feels: core speed and surface angles, after actuators, yaw damper and spool lag.
INPUTS = {"n2": ("%", 4.0), "elevator": ("rad", 0.04), "aileron": ("rad", 0.08), "rudder": ("rad", 0.04)}
# name: (unit, expected deviation, noise standard deviation, resolution of the recorded number)
SENSORS = {
    "airspeed": ("m/s", 6.0, 0.5, 1e-3),
    "alpha_vane": ("rad", 0.03, 0.15 * DEG, 1e-5),
    "beta_vane": ("rad", 0.03, 0.15 * DEG, 1e-5),
    "roll_rate": ("rad/s", 0.2, 0.05 * DEG, 1e-5),
    "pitch_rate": ("rad/s", 0.04, 0.05 * DEG, 1e-5),
    "yaw_rate": ("rad/s", 0.04, 0.05 * DEG, 1e-5),
    "roll_angle": ("rad", 0.25, 0.1 * DEG, 1e-5),
    "pitch_angle": ("rad", 0.06, 0.1 * DEG, 1e-5),
    "vertical_speed": ("m/s", 8.0, 0.3, 1e-3),
    "lateral_accel": ("m/s^2", 1.0, 0.05, 1e-4),
    "normal_accel": ("m/s^2", 3.0, 0.05, 1e-4),
}
# name: (unit, root mean square at this altitude in turbulence of severity 3)
GUSTS = {
    "gust_u": ("m/s", 1.1), "gust_v": ("m/s", 1.1), "gust_w": ("m/s", 1.1),
    "gust_p": ("rad/s", 0.02), "gust_q": ("rad/s", 0.01), "gust_r": ("rad/s", 0.01),
}  # fmt: skip
FAULTS = {"pitch_rate": 2.5 * DEG, "pitch_angle": 2.5 * DEG, "roll_rate": 2.5 * DEG}  # name = sensor: size
LOGS = [(name, air) for name in ("healthy", *FAULTS, "all_three") for air in ("calm", "gust")]


def load(folder):
    """A fresh 737 executive, made from a copy of the shipped model without its two network sockets."""
    root = Path(jsbsim.get_default_root_dir())
    model = Path(folder) / "737" / "737.xml"
    if not model.exists():
        model.parent.mkdir(parents=True)
        text = (root / "aircraft" / "737" / "737.xml").read_text()
        model.write_text(re.sub(r"<input port.*?(/>|</input>)", "", text, flags=re.S))
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    fdm.load_model_with_paths("737", str(folder), str(root / "engine"), str(root / "systems"))
    fdm.set_dt(STEP)
    return fdm


def trim(fdm):
    """Trim straight and level, northbound on the equator (no sideways Coriolis pull); returns x0, u0."""
    fdm["ic/h-sl-ft"] = ALTITUDE_FT
    fdm["ic/vc-kts"] = CALIBRATED_KT
    fdm["ic/gamma-deg"] = 0.0
    fdm["gear/gear-cmd-norm"] = fdm["gear/gear-pos-norm"] = 0.0
    fdm.run_ic()
    fdm["propulsion/set-running"] = -1
    fdm["propulsion/fuel_freeze"] = 1  # constant mass: the linear model has no fuel state
    fdm["simulation/do_simple_trim"] = 1
    return state(fdm), inputs(fdm)


def place(fdm, x, u, gust=(0.0, 0.0, 0.0)):
    """Put the aircraft at state x with inputs u in steady air moving with `gust` (m/s), time standing still."""
    V, alpha, beta, p, q, r, phi, theta = x
    fdm["ic/phi-rad"], fdm["ic/theta-rad"], fdm["ic/psi-true-rad"] = phi, theta, 0.0
    fdm["ic/u-fps"] = V * np.cos(alpha) * np.cos(beta) / FT
    fdm["ic/v-fps"] = V * np.sin(beta) / FT
    fdm["ic/w-fps"] = V * np.sin(alpha) * np.cos(beta) / FT
    fdm["ic/p-rad_sec"], fdm["ic/q-rad_sec"], fdm["ic/r-rad_sec"] = p, q, r
    fdm["ic/h-sl-ft"] = ALTITUDE_FT
    fdm["fcs/pitch-trim-cmd-norm"] = 0.0
    command(fdm, u, damper=r)
    fdm.run_ic()
    for axis, speed in zip(("north", "east", "down"), gust, strict=True):
        fdm[f"atmosphere/wind-{axis}-fps"] = -speed / FT  # heading north: headwind, wind from the right, updraught
    for engine in (0, 1):
        fdm[f"propulsion/engine[{engine}]/n2"] = u[0]
    fdm.suspend_integration()
    for _ in range(8):  # the pitching moment uses alpha-dot of the pass before
        fdm.run()


def command(fdm, u, damper=0.0):
    """Ask for core speed and surface angles; the yaw damper adds its own yaw rate to the rudder, so take it off."""
    fdm["fcs/elevator-cmd-norm"] = u[1] / 0.30  # full travel in rad, from 737.xml
    fdm["fcs/aileron-cmd-norm"] = u[2] / 0.35
    fdm["fcs/rudder-cmd-norm"] = u[3] / 0.35 - damper
    for engine in (0, 1):
        fdm[f"fcs/throttle-cmd-norm[{engine}]"] = (u[0] - 60) / 40  # idle 60 %, full 100 %


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


def inputs(fdm):
    """u in the order of INPUTS: what the airframe feels, not what was commanded."""
    return np.array([fdm["propulsion/engine/n2"], fdm["fcs/elevator-pos-rad"],
                     fdm["fcs/left-aileron-pos-rad"], fdm["fcs/rudder-pos-rad"]])  # fmt: skip


def outputs(fdm):
    """y in the order of SENSORS, without noise; the accelerometers sit at the centre of gravity."""
    force = [fdm[f"forces/fb{c}-aero-lbs"] + fdm[f"forces/fb{c}-prop-lbs"] for c in "yz"]
    ay, az = np.array(force) / fdm["inertia/mass-slugs"] * FT
    return np.array([fdm["velocities/vt-fps"] * FT, fdm["aero/alpha-rad"], fdm["aero/beta-rad"],
                     *state(fdm)[3:], fdm["velocities/h-dot-fps"] * FT, ay, -az])  # fmt: skip


def gusts(fdm):
    """The air's motion in the order of GUSTS, signs as in the plant file (headwind, from the right, up)."""
    wind = [fdm[f"atmosphere/total-wind-{axis}-fps"] * FT for axis in ("north", "east", "down")]
    return -np.array([*wind, *(fdm[f"atmosphere/{c}-turb-rad_sec"] for c in "pqr")])


def linearise(fdm, x0, u0):
    """Central differences of (dx/dt, y) over state, input and gust; returns A, B, C, D, E_w, F_w."""
    n = len(STATES)

    def at(dx=0.0, du=0.0, gust=(0.0, 0.0, 0.0)):
        place(fdm, x0 + dx, u0 + du, gust)
        both = np.concatenate([state_rate(fdm), outputs(fdm)])
        fdm.resume_integration()
        return both

    def slope(key, steps):
        moves = [step * row for step, row in zip(steps, np.eye(len(steps)), strict=True)]
        J = np.array([(at(**{key: d}) - at(**{key: -d})) / (2 * d.max()) for d in moves]).T
        cause = np.array([s[1] for s in names[key].values()])[: len(steps)]
        return np.where(abs(J) * cause < 1e-3 * effect[:, None], 0.0, J.round(9))

    names = {"dx": STATES, "du": INPUTS, "gust": GUSTS}
    # Couplings that move a state by less than 0.1 % of its range per second (an output by 0.1 % of its range) are
    # set to zero: they are the Earth's rotation and rounding.  Nine decimals are what the steps resolve.
    effect = np.array([s[1] for s in (*STATES.values(), *SENSORS.values())])
    AC = slope("dx", [0.5] + 7 * [0.005])  # m/s, then rad and rad/s
    BD = slope("du", [0.5] + 3 * [0.005])  # %, then rad
    EF = slope("gust", 3 * [0.5])  # m/s
    A, C = AC[:n], AC[n:]
    Ew = np.hstack([EF[:n], np.zeros((n, 3))])
    Ew[3:6, 3:] = A[3:6, 3:6]  # turning air acts as the aircraft turning in still air
    Fw = np.hstack([EF[n:], np.zeros((len(SENSORS), 3))])
    return A, BD[:n], C, BD[n:], Ew, Fw


def differences(fdm, x0, u0, A):
    """The couplings in which JSBSim's own FGLinearization differs from ours by more than 5 %."""
    place(fdm, x0, u0)
    fdm.resume_integration()
    model = jsbsim.FGLinearization(fdm)
    rows = [model.x_names.index(name) for name in ("Vt", "Alpha", "Beta", "P", "Q", "R", "Phi", "Theta")]
    to_si = np.array([FT] + 7 * [1.0])
    theirs = model.system_matrix[np.ix_(rows, rows)] * to_si[:, None] / to_si
    theirs[:, 5] -= model.input_matrix[rows, model.u_names.index("DrCmd")] * to_si  # it closes the yaw damper
    size = np.array([s[1] for s in STATES.values()])
    matter = abs(A - theirs) * size / size[:, None]  # 1/s, with every state in units of its range
    name = list(STATES)
    return [{"row": name[i], "column": name[j], "ours": A[i, j], "theirs": round(theirs[i, j], 9)}
            for i, j in np.argwhere((matter > 2e-3) & (abs(A - theirs) > 0.05 * abs(A)))]  # fmt: skip


def mismatch(t, x, u, x0, u0, A, B):
    """Root-mean-square error of the linear model per state, relative to that state's own motion."""
    model = (A, B, np.eye(len(A)), np.zeros_like(B))
    _, z, _ = lsim(model, u - u0, t, X0=x[0] - x0, interp=False)  # inputs held from sample to sample
    return np.sqrt(((z + x0 - x) ** 2).mean(0) / ((x - x0) ** 2).mean(0))


def doublet(t, start, length, size):
    """Up for one length, down for the next."""
    return size * (start <= t < start + length) - size * (start + length <= t < start + 2 * length)


def three_two_one_one(t, start, unit, size):
    """The classic identification input: steps of 3, 2, 1 and 1 units of time, with alternating sign."""
    edges = start + unit * np.array([0, 3, 5, 6, 7])
    signs = (size, -size, size, -size)
    return sum(s * (a <= t < b) for s, a, b in zip(signs, edges, edges[1:], strict=False))


def manoeuvre(rng):
    """Deviation of u over time: multi-axis, the same plan in each log with its own timing and size."""
    late = rng.uniform(-0.5, 0.5, 9)  # s
    big = rng.uniform(0.85, 1.15, 9)

    def plan(t):
        n2 = 3.0 * big[0] * (12 + late[0] <= t < 30) - 2.0 * big[1] * (38 + late[1] <= t < 52)  # %
        elevator = (three_two_one_one(t, 3 + late[2], 1.2, 0.015 * big[2])                           # rad
                    + three_two_one_one(t, 23 + late[3], 1.2, 0.018 * big[3])
                    + doublet(t, 42 + late[4], 2.0, 0.012 * big[4]))  # fmt: skip
        rolls = ((10, 0.05), (27, -0.06), (33, 0.05), (40, -0.05), (47, 0.06), (54, -0.05))  # s, rad
        aileron = sum(doublet(t, start + late[5], 1.6, size * big[5]) for start, size in rolls)
        rudder = doublet(t, 16 + late[6], 1.5, 0.02 * big[6]) + doublet(t, 36 + late[7], 1.5, -0.02 * big[7])
        return np.array([n2, elevator, aileron, rudder])

    return plan


def fly(folder, x0, u0, plan, *, duration=DURATION, gust_seed=None, hold=True, every=2):
    """Fly a plan with the nonlinear model; returns t, u, x, y, w sampled every so many steps of the simulator.

    A gentle attitude hold on the true state keeps the aircraft near its operating point.  It never sees a
    sensor, so a sensor fault does not change the flight.
    """
    fdm = load(folder)
    trim(fdm)
    place(fdm, x0, u0)
    if gust_seed is not None:
        fdm["simulation/randomseed"] = gust_seed
        fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = 50.0  # used near the ground only
        fdm["atmosphere/turbulence/milspec/severity"] = 3  # MIL-F-8785C
        fdm["atmosphere/turb-type"] = 3
    fdm.resume_integration()
    rows = []
    for k in range(round(duration / STEP) + 1):
        x = state(fdm)
        if k % every == 0:
            rows.append(np.concatenate([[k * STEP], inputs(fdm), x, outputs(fdm), gusts(fdm)]))
        u = u0 + plan(k * STEP)
        if hold:
            u[1] += 0.25 * (x[7] - x0[7]) + 0.2 * x[4]
            u[2] -= 0.15 * x[6] + 0.1 * x[3]
        command(fdm, u)
        fdm.run()
    sizes = [1, len(INPUTS), len(STATES), len(SENSORS), len(GUSTS)]
    t, u, x, y, w = np.split(np.array(rows), np.cumsum(sizes)[:-1], axis=1)
    return t[:, 0], u, x, y, w


def waveform(name, t, y):
    """The additive fault on sensor `name`, whose true reading is y, with a phrase that describes it."""
    if name == "pitch_rate":
        ramp = np.clip((t - ONSET) / 25.0, 0.0, 1.0)
        return FAULTS[name] * ramp, "drifts from 20 s, reaches 2.5 deg/s at 45 s and stays there"
    if name == "pitch_angle":
        return FAULTS[name] * (t >= ONSET), "a bias of 2.5 deg from 20 s"
    return -0.4 * y * (t >= ONSET), "loses 40 % of its effectiveness from 20 s, recorded as an additive fault"


def record(folder, x0, u0, name, air, number):
    """One log as a table, its facts for the provenance file, and the noise-free t, u, x."""
    seeds = {"manoeuvre": 100 + number, "noise": 200 + number, "gust": 300 + number if air == "gust" else None}
    plan = manoeuvre(np.random.default_rng(seeds["manoeuvre"]))
    t, u, x, y, w = fly(folder, x0, u0, plan, gust_seed=seeds["gust"])
    gust_rms = np.sqrt((w**2).mean(0))
    if (gust_rms.min() > 0) != (air == "gust"):  # the simulator accepts turbulence settings that do nothing
        raise RuntimeError(f"{name}, {air}: the air moves by {gust_rms} (rms, m/s and rad/s)")
    _, noise, step = np.array([s[1:] for s in SENSORS.values()]).T
    true = dict(zip(SENSORS, y.T, strict=True))
    acting = {f: waveform(f, t, true[f]) for f in FAULTS if name in (f, "all_three")}
    faults = {f: acting[f][0] if f in acting else np.zeros_like(t) for f in FAULTS}
    for f in acting:
        y[:, list(SENSORS).index(f)] += faults[f]
    y += np.random.default_rng(seeds["noise"]).normal(size=y.shape) * noise
    table = {"t": t.round(6)} | dict(zip(INPUTS, u.T.round(6) + 0.0, strict=True))
    table |= dict(zip(SENSORS, (np.round(y / step) * step).T + 0.0, strict=True))
    table |= {f"true_f_{f}": v + 0.0 for f, v in faults.items()}
    table |= {f"true_x_{s}": v + 0.0 for s, v in zip(STATES, x.T.round(6), strict=True)}
    rms = {f: np.sqrt((faults[f][t >= ONSET] ** 2).mean()) for f in acting}
    facts = {"faults": {f: about for f, (_, about) in acting.items()}, "onset_s": ONSET if acting else None,
             "fault_rms_while_acting": named(rms, rms.values()), "seeds": seeds,
             "gust_rms": named(GUSTS, gust_rms), "largest_deviation": named(STATES, abs(x - x0).max(0))}  # fmt: skip
    frame = pd.DataFrame(table)
    return frame.astype({c: "float32" for c in frame.columns if c != "t"}), facts, (t, u, x)


def replace(path, write):
    """Write beside the target and rename, so that nobody ever reads half a file."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name + ".")
    os.close(handle)
    try:
        write(name)
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def toml_table(names, values):
    """An inline table with every number in full."""
    return "{ " + ", ".join(f"{n} = {float(v)!r}" for n, v in zip(names, values, strict=True)) + " }"


def plant_file(x0, u0, y0, A, B, C, D, Ew, Fw):
    """The plant as TOML text: every number in full, names as in the logs."""
    groups = {"x": (STATES, x0), "u": (INPUTS, u0), "y": (SENSORS, y0)}
    lines = ["# Boeing 737 of JSBSim in cruise: 20,000 ft, 300 kt calibrated.  Written by examples/airliner/record.py.",
             "schema = 1", 'name   = "airliner, Boeing 737 in cruise"', "[signals]"]  # fmt: skip
    for key, (group, _) in groups.items():
        lines.append(f"{key} = [" + ", ".join(f'"{n} [{s[0]}]"' for n, s in group.items()) + "]")
    ranges = {n: s[1] for group, _ in groups.values() for n, s in group.items()}
    lines += ["range = " + toml_table(ranges, ranges.values()),
              "[noise]", f"hold = {HOLD}", "sd   = " + toml_table(SENSORS, [s[2] for s in SENSORS.values()]),
              "[operating_point]"]  # fmt: skip
    lines += [f"{key} = " + toml_table(group, point) for key, (group, point) in groups.items()]
    lines += ["[matrices]"]
    for letter, M in zip("ABCD", (A, B, C, D), strict=True):
        lines.append(f"{letter} = [" + ",\n     ".join(str(row) for row in M.tolist()) + "]")
    for j, (name, (unit, size)) in enumerate(GUSTS.items()):
        into = {s: v for s, v in zip(STATES, Ew[:, j], strict=True) if v}
        on = {s: v for s, v in zip(SENSORS, Fw[:, j], strict=True) if v}
        lines += ["[[disturbance]]", f'name = "{name}"  # {unit}',
                  "into = " + toml_table(into, into.values()), "on   = " + toml_table(on, on.values()),
                  f"size = {size}", 'role = "attenuate"']  # fmt: skip
    for name, sensor in SENSORS.items():
        lines += ["[[disturbance]]", f'name = "noise_{name}"', f"on   = {{ {name} = 1.0 }}", f"size = {sensor[2]!r}",
                  'role = "attenuate"']  # fmt: skip
    for name, size in FAULTS.items():
        lines += ["[[fault]]", f'name = "{name}"', f'sensor = "{name}"', 'effect = "additive"', f"size = {size:.4f}"]
    return "\n".join(lines) + "\n"


def small_doublets(folder, x0, u0, A, B):
    """Per input, the linear model's error over 15 s after a small doublet from trim, hands off."""
    tried = {"n2": (5.0, 1.0), "elevator": (1.5, 0.005), "aileron": (1.5, 0.01), "rudder": (1.5, 0.005)}  # s, % or rad
    errors = {}
    for name, (length, size) in tried.items():
        axis = np.array([name == other for other in INPUTS])

        def plan(t, axis=axis, length=length, size=size):
            return doublet(t, 1.0, length, size) * axis

        t, u, x, _, _ = fly(folder, x0, u0, plan, duration=15.0, hold=False, every=1)
        errors[name] = named(STATES, mismatch(t, x, u, x0, u0, A, B))
    return errors


def named(group, values):
    """Numbers by name, to three digits, for the provenance file."""
    return {name: float(f"{v:.3g}") for name, v in zip(group, values, strict=True)}


def write_log(out, stem, frame):
    """Parquet for every log; one also as CSV with the columns a flight recorder would have, and the fault."""
    compact = {"index": False, "compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    replace(out / f"{stem}.parquet", lambda name: frame.to_parquet(name, **compact))
    if stem == "pitch_rate_calm":
        table = frame[[c for c in frame.columns if not c.startswith("true_x_")]]
        plain = {"index": False, "float_format": "%.6g", "lineterminator": "\n"}
        replace(out / f"{stem}.csv", lambda name: table.to_csv(name, **plain))


def write_all(folder, out):
    """Write everything but the provenance file, whose contents are returned."""
    fdm = load(folder)
    x0, u0 = trim(fdm)
    y0, residual = outputs(fdm), state_rate(fdm)
    A, B, C, D, Ew, Fw = linearise(fdm, x0, u0)
    plant = plant_file(x0, u0, y0, A, B, C, D, Ew, Fw)
    replace(out / "airliner.toml", lambda name: Path(name).write_text(plant, newline="\n"))
    logs = {}
    for number, (name, air) in enumerate(LOGS):
        frame, about, (t, u, x) = record(folder, x0, u0, name, air, number)
        if air == "calm":
            about["linear_model_error"] = named(STATES, mismatch(t, x, u, x0, u0, A, B))
        write_log(out, f"{name}_{air}", frame)
        logs[f"{name}_{air}"] = about
    return {
        "simulator": "JSBSim, aircraft model 737", "jsbsim": version("jsbsim"), "python": platform.python_version(),
        "numpy": version("numpy"), "pyarrow": version("pyarrow"), "script": "examples/airliner/record.py",
        "log": {"sample_time_s": HOLD, "duration_s": DURATION, "simulator_step_s": STEP,
                "manoeuvre": "elevator 3-2-1-1 and doublet, aileron and rudder doublets, steps of core speed"},
        "trim": {"altitude_ft": ALTITUDE_FT, "calibrated_airspeed_kt": CALIBRATED_KT,
                 "x0": named(STATES, x0), "u0": named(INPUTS, u0), "rate_at_trim": named(STATES, residual)},
        "linearisation": {"method": "central differences of the simulator, inertial states",
                          "differs_from_FGLinearization": differences(fdm, x0, u0, A),
                          "error_after_small_doublets": small_doublets(folder, x0, u0, A, B)},
        "logs": logs,
    }  # fmt: skip


def main():
    """Record everything into the folder given by --out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("src/faultrecon/data/airliner"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        facts = write_all(Path(folder), out)
    text = json.dumps(facts, indent=1) + "\n"
    replace(out / "provenance.json", lambda name: Path(name).write_text(text, newline="\n"))


if __name__ == "__main__":
    main()
