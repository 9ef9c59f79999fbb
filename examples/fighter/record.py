# SPDX-License-Identifier: BSD-3-Clause
"""Fly JSBSim's F-16 with its pitch-rate gyro failing inside the loop, and record the logs behind the fighter example.

    python examples/fighter/record.py                          # corrected by the hand-made observer of loop.py
    python examples/fighter/record.py --method sliding-mode    # and by the estimator of a design: what ships

What is written: the linear plant, flights without a fault and with a ramp, a step and a sine on the gyro, with the
faulty sensor in the loop and with the corrected one, and `provenance.json`.
"""

import argparse
import json
import os
import platform
import tempfile
from importlib.metadata import version
from pathlib import Path

import aircraft
import loop
import numpy as np
import pandas as pd
from aircraft import ALTITUDE_FT, FUEL_LB, INPUTS, SPEED, STATES, STEP
from scipy.linalg import eigvals, expm

DEG = np.pi / 180
HOLD, DURATION, ONSET = 0.02, 50.0, 10.0  # s: sample time of loop, logs and noise; length; when faults begin
GYRO = ("rad/s", 0.05, 0.05 * DEG, 2.0**-14)  # resolutions are powers of two: such numbers pack well
# name: (unit, expected deviation, noise standard deviation, resolution of the recorded number)
SENSORS = {"roll_rate": ("rad/s", 0.1, *GYRO[2:]), "pitch_rate": GYRO, "yaw_rate": ("rad/s", 0.03, *GYRO[2:])}
# What would make it easy; recorded beside, but no sensors of the plant.
BESIDE = {"airspeed": ("m/s", 6.0, 0.5, 2.0**-5), "alpha_vane": ("rad", 0.04, 0.15 * DEG, 2.0**-12),
          "pitch_angle": ("rad", 0.1, 0.1 * DEG, 2.0**-12)}  # fmt: skip
GUSTS = {"gust_u": "m/s", "gust_w": "m/s"}  # headwind, up
SIZE, RAMP = 1.5 * DEG, 15.0  # rad/s, and the seconds the drift takes to get there
STEEP, OMEGA = 0.5, 0.15  # s over which the step rises; rad/s of the sine
FAULTS = {
    "ramp": "drifts from 10 s by 0.1 deg/s per second, reaches 1.5 deg/s at 25 s and stays there",
    "step": "1.5 deg/s from 10 s, through a slope of 0.5 s",
    "sine": "1.5 deg/s sin(0.15 (t - 10 s)) from 10 s",
}
LARGEST_RATE = SIZE / STEEP
FINE = 2.0**-18  # resolution of inputs and true values in the logs; of speed, in m/s, 2^-10
GROUND = 500.0  # ft above ground at which a flight is over


def fault(name):
    """The additive fault on the pitch-rate gyro as a function of time, rad/s."""
    shapes = {
        "healthy": lambda t: 0.0 * t,
        "ramp": lambda t: SIZE * np.clip((t - ONSET) / RAMP, 0.0, 1.0),
        "step": lambda t: SIZE * np.clip((t - ONSET) / STEEP, 0.0, 1.0),
        "sine": lambda t: SIZE * np.sin(OMEGA * np.maximum(t - ONSET, 0.0)),
    }
    return shapes[name]


def doublet(t, start, length, size):
    """Up for one length, down for the next."""
    return size * ((start <= t < start + length) - 1.0 * (start + length <= t < start + 2 * length))


def pilot(t):
    """Commanded pitch rate (rad/s), and pushes on aileron and rudder (rad): the same in every flight."""
    pitch = ((3.0, 1.5), (14.0, -1.5), (22.0, 1.5), (31.0, -1.2), (42.0, 1.2))  # s, deg/s
    q = sum(doublet(t, start, 1.5, size * DEG) for start, size in pitch)
    return q, doublet(t, 18.0, 0.6, 0.012) + doublet(t, 37.0, 0.6, -0.012), doublet(t, 27.0, 1.0, 0.015)


def fly(fdm, x0, u0, acting, corrector, duration=DURATION):
    """One flight with the loop closed through the corrector; returns t, u, x, y, beside, and the pitch rate it used.

    It ends early GROUND feet above the ground.  acting: the fault on the gyro as a function of time.  corrector:
    (t, u, y) -> y, called once per sample.  Noise has the same seed in every flight, so that flights differ by their
    fault and correction alone.
    """
    aircraft.place(fdm, x0, u0)
    fdm.resume_integration()
    rng, noise = np.random.default_rng(17), np.array([s[2] for s in (*SENSORS.values(), *BESIDE.values())])
    step = np.array([s[3] for s in (*SENSORS.values(), *BESIDE.values())])
    u, integral, rows = u0.copy(), 0.0, []
    for k in range(round(duration / HOLD) + 1):
        t, x = k * HOLD, aircraft.state(fdm)
        y = np.concatenate([x[3:6], x[[0, 1, 7]]]) + noise * rng.normal(size=len(noise))
        y[1] += acting(t)
        y = np.round(y / step) * step
        used = corrector(t, u.copy(), y[:3].copy())
        rows.append(np.concatenate([[t], u, x, y, [used[1]]]))
        if fdm["position/h-agl-ft"] < GROUND:
            break
        q, aileron, rudder = pilot(t)
        error = used[1] - q
        integral += error * HOLD
        wanted = u0 + [0.0, loop.KP * error + loop.KI * integral, aileron, rudder + loop.YAW_DAMPER * used[2]]
        for _ in range(round(HOLD / STEP)):
            move = (1 - np.exp(-STEP / loop.LAG)) * (wanted - u)[1:]
            u[1:] = np.clip(u[1:] + np.clip(move, -loop.RATE * STEP, loop.RATE * STEP), -loop.TRAVEL, loop.TRAVEL)
            aircraft.command(fdm, u)
            fdm.run()
    sizes = np.cumsum([1, len(INPUTS), len(STATES), len(SENSORS), len(BESIDE)])
    t, u, x, y, beside, used = np.split(np.array(rows), sizes, axis=1)
    return t[:, 0], u, x, y, beside, used[:, 0]


def ahead(t, u, x, x0, u0, A, B, horizon=1.0):
    """Root-mean-square error of the linear model when it predicts `horizon` seconds ahead, over the motion, by state.

    From every true state on, with the inputs that were flown.  Longer does not make sense: what is unstable grows.
    """
    n, m, h = *B.shape, t[1] - t[0]
    block = np.zeros((n + m, n + m))
    block[:n] = np.hstack([A, B]) * h
    Phi, steps = expm(block), round(horizon / h)
    z, held = (x - x0)[:-steps], (u - u0)
    for k in range(steps):
        mean = (held[k : len(held) - steps + k] + held[k + 1 : len(held) - steps + k + 1]) / 2
        z = z @ Phi[:n, :n].T + mean @ Phi[:n, n:].T
    return np.sqrt(((z - (x - x0)[steps:]) ** 2).mean(0) / ((x - x0) ** 2).mean(0))


def table(flight, acting):
    """One log as a table: what a recorder on board has, and the truth beside it."""
    t, u, x, y, beside, used = flight
    truth = dict(zip((f"true_x_{s}" for s in STATES), x.T, strict=True))
    columns = dict(zip(INPUTS, u.T, strict=True)) | {"used_pitch_rate": used, "true_f_pitch_rate": acting(t)} | truth
    columns = {c: np.round(v / res) * res + 0.0 for c, v in columns.items()
               for res in [2.0**-10 if c in ("n2", "true_x_V") else FINE]}  # fmt: skip
    columns |= dict(zip((*SENSORS, *BESIDE), np.hstack([y, beside]).T + 0.0, strict=True))
    order = ["t", *INPUTS, *SENSORS, *BESIDE, "used_pitch_rate", "true_f_pitch_rate", *truth]
    frame = pd.DataFrame(columns | {"t": t.round(6)})[order]
    return frame.astype({c: "float32" for c in order if c != "t"})


def harm(flight, reference):
    """How far a flight strays from the one without fault and correction: pitch angle and rate, in degrees."""
    off = (flight[2] - reference[2][: len(flight[2])])[:, [4, 7]] / DEG
    t, steady = flight[0], flight[0] >= ONSET
    told = {
        "pitch_angle_at_end_deg": off[-1, 1], "pitch_angle_largest_deg": abs(off[:, 1]).max(),
        "pitch_rate_rms_deg_s": np.sqrt((off[steady, 0] ** 2).mean()), "elevator_rms_rad": flight[1][steady, 1].std(),
        "flown_s": t[-1],
    }  # fmt: skip
    return named(told, told.values())


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


def plant_file(x0, u0, A, B, E_w):
    """The plant as TOML text: rate gyros only, the pitch-rate gyro may fail."""
    groups = {"x": (STATES, x0), "u": (INPUTS, u0), "y": (SENSORS, np.zeros(3))}
    lines = ["# F-16 of JSBSim, bare airframe, tanks full: 5,000 ft, 190 m/s.  Written by examples/fighter/record.py.",
             "schema = 1", 'name   = "fighter, F-16 unstable in pitch"',
             'source = "JSBSim aircraft model f16 (NASA TP-1538 data), linearised by examples/fighter/record.py"',
             "", "[signals]"]  # fmt: skip
    for key, (group, _) in groups.items():
        lines.append(f"{key} = [" + ", ".join(f'"{n} [{s[0]}]"' for n, s in group.items()) + "]")
    ranges = {n: s[1] for group, _ in groups.values() for n, s in group.items()}
    lines += ["range = " + toml_table(ranges, ranges.values()), "", "[noise]", f"hold = {HOLD}",
              "sd   = " + toml_table(SENSORS, [s[2] for s in SENSORS.values()]), "", "[operating_point]"]  # fmt: skip
    lines += [f"{key} = " + toml_table(group, point) for key, (group, point) in groups.items()]
    C = np.eye(len(STATES))[3:6]
    lines += ["", "[matrices]"]
    for letter, M in zip("ABC", (A, B, C), strict=True):
        lines.append(f"{letter} = [\n  " + ",\n  ".join(str(row) for row in M.tolist()) + ",\n]")
    for j, (name, unit) in enumerate(GUSTS.items()):
        into = {s: v for s, v in zip(STATES, E_w[:, j], strict=True) if v}
        lines += ["", "[[disturbance]]", f'name = "{name}"  # {unit}; the flights are in calm air',
                  "into = " + toml_table(into, into.values()), "size = 0.5", 'role = "noise"']  # fmt: skip
    lines += ["", "[[fault]]", 'name   = "pitch_rate"', 'sensor = "pitch_rate"', 'effect = "additive"',
              f"size   = {SIZE:.4f}", f"rate   = {LARGEST_RATE:.4f}"]  # fmt: skip
    return "\n".join(lines) + "\n"


def named(group, values):
    """Numbers by name, to three digits, for the provenance file."""
    return {name: float(f"{v:.3g}") for name, v in zip(group, values, strict=True)}


def analysis(A, B):
    """What linear theory says about the loop: healthy, and through observers of several speeds."""
    told = {"unstable_mode": float(max(eigvals(A).real)), "floor_s": float(1 / max(eigvals(A).real)), "loops": {}}
    for speed in (None, 0.5, 1.0, 2.0, 4.0, 8.0):
        peak, at, pole = loop.at_the_sensor(A, B, speed)
        rest, zero = loop.slowest(loop.closed_loop(A, B, speed))
        facts = {"slowest_pole": rest, "structural_zero": zero, "sensor_sensitivity_peak": peak, "at_rad_s": at,
                 "compensator_pole": pole}  # fmt: skip
        low, high = loop.gain_limits(A, B, speed)
        told["loops"]["no correction" if speed is None else f"observer speed {speed:g}"] = {
            **named(facts, facts.values()), "stable_for_sensor_gain": [low, high],
            "held_of_aircraft_20_percent_off": round(loop.survivors(A, B, speed), 3)}  # fmt: skip
    return told


def write_log(out, stem, frame):
    """One log as Parquet, small."""
    compact = {"index": False, "compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    replace(out / f"{stem}.parquet", lambda name: frame.to_parquet(name, **compact))


def correctors(A, B, x0, u0, plant, method):
    """Makers of correctors by name, each called afresh for every flight."""
    made = {
        "faulty": lambda acting: loop.corrector_none(),
        "oracle": lambda acting: loop.corrector_oracle(acting, 1),
        "linear": lambda acting: loop.corrector_linear(A, B, x0, u0, HOLD),
    }
    if method is None:
        return made, None
    import faultrecon as fr

    design = fr.design(fr.load(plant), method)
    facts = {"level": design.level, "floor": design.floor, "verdict": design.verification.verdict}
    name = method.replace("-", "_")
    return made | {name: lambda acting: loop.corrector_design(design, HOLD, x0)}, {"method": method, **facts}


def write_all(folder, out, plant_path, method):
    """Write plant and logs; the contents of the provenance file come back."""
    fdm = aircraft.load(folder)
    x0, u0 = aircraft.trim(fdm)
    A, B, E_w = aircraft.linearise(fdm, x0, u0)
    aft, mass = aircraft.aft_of_reference(fdm)
    replace(plant_path, lambda name: Path(name).write_text(plant_file(x0, u0, A, B, E_w), newline="\n"))
    makers, design = correctors(A, B, x0, u0, plant_path, method)
    reference = fly(fdm, x0, u0, fault("healthy"), loop.corrector_none())
    logs = {}
    for name, how in [(name, how) for name in ("healthy", *FAULTS) for how in makers]:
        acting, healthy = fault(name), name == "healthy"
        if healthy and how == "oracle":
            continue
        plain = healthy and how == "faulty"
        flight = reference if plain else fly(fdm, x0, u0, acting, makers[how](acting))
        stem = "healthy" if plain else f"{name}_{how}"
        if how != "oracle":
            write_log(out, stem, table(flight, acting))
        logs[stem] = {"fault": FAULTS.get(name), "corrected_by": None if how == "faulty" else how,
                      "shipped": how != "oracle", "strays_from_healthy": harm(flight, reference),
                      "largest_deviation": named(STATES, abs(flight[2] - x0).max(0)),
                      "linear_model_error_1_s_ahead": named(STATES, ahead(*flight[:3], x0, u0, A, B))}  # fmt: skip
    return {
        "simulator": "JSBSim, aircraft model f16, flight control taken out", "jsbsim": version("jsbsim"),
        "python": platform.python_version(), "numpy": version("numpy"), "scipy": version("scipy"),
        "pyarrow": version("pyarrow"), "script": "examples/fighter/record.py",
        "log": {"sample_time_s": HOLD, "duration_s": DURATION, "simulator_step_s": STEP, "noise_seed": 17},
        "configuration": {"fuel_lb": FUEL_LB, "mass_kg": round(mass), "cg_aft_of_aero_reference_m": round(aft, 4)},
        "trim": {"altitude_ft": ALTITUDE_FT, "speed_m_s": SPEED, "x0": named(STATES, x0), "u0": named(INPUTS, u0),
                 "rate_at_trim": named(STATES, aircraft.rate_at(fdm, x0, u0))},
        "modes": [[float(f"{s.real:.6g}"), float(f"{s.imag:.6g}")] for s in sorted(eigvals(A), key=lambda s: -s.real)],
        "loop": {"law": "elevator = kp (q - command) + ki integral of it", "kp": loop.KP, "ki": loop.KI,
                 "yaw_damper": loop.YAW_DAMPER, "actuator_lag_s": round(loop.LAG, 5), **analysis(A, B)},
        "design": design, "logs": logs,
    }  # fmt: skip


def main():
    """Record everything into the folder given by --out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("src/faultrecon/data/fighter"))
    parser.add_argument("--plant", type=Path, default=Path("src/faultrecon/plant/library/fighter.toml"))
    parser.add_argument("--method", help="correct with a design of faultrecon by this method, too")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        facts = write_all(Path(folder), given.out, given.plant, given.method)
    text = json.dumps(facts, indent=1) + "\n"
    replace(given.out / "provenance.json", lambda name: Path(name).write_text(text, newline="\n"))


if __name__ == "__main__":
    main()
