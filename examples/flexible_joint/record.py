# SPDX-License-Identifier: BSD-3-Clause
"""Move a flexible joint with friction in MuJoCo, its motor encoder failing in six ways, and record the logs.

    python examples/flexible_joint/record.py     # needs mujoco, pandas, pyarrow; about 3 s

What is written: a run without a fault, one for each kind of fault in Table 1 of Huang, Gao and Liu (Sensors 24, 2024,
3224) at a fifth of its size, and `provenance.json`.
"""

import argparse
import json
import os
import platform
import tempfile
from importlib.metadata import version
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

MODEL = Path(__file__).with_name("joint.xml")
HOLD, DURATION, ONSET, SEED = 0.005, 20.0, 4.0, 6  # s: sample time of computer, logs and noise; length; first fault
KP, KD, LAG, LIMIT = 2.0, 0.2, 0.01, 3.0  # V/rad, V s/rad; lag of the amplifier, s; V
SIZE, EDGE = 0.2, 0.1  # rad; s over which the square wave and the bias change
STATES = ("theta_m", "omega_m", "theta_l", "omega_l")
# name: (noise standard deviation, resolution); powers of two pack well
SENSORS = {"motor_encoder": (5e-4, 2.0**-13), "tacho": (0.01, 2.0**-9), "link_encoder": (5e-4, 2.0**-13)}
FINE = 2.0**-16  # resolution of voltage, true states and true fault in the logs
TOLD = {
    "bias": "0.2 rad from 4 s, through a slope of 0.1 s",
    "incipient": "drifts from 4 s by 0.0125 rad per second, reaches 0.2 rad at 20 s",
    "loss": "shows 20 % less than the angle from 4 s: f = -0.2 theta_m, through a slope of 0.1 s",
    "slow_sine": "0.2 rad sin(0.5 (t - 4 s)) from 4 s",
    "fast_sine": "0.2 rad sin(12 (t - 4 s)) from 4 s",
    "square": "0.2 rad and -0.2 rad in turn from 4 s, period 2 s, edges of 0.1 s",
}


def fault(kind):
    """The additive fault on the motor encoder as a function of time and true angle, rad."""

    def square(since):
        """1 and -1 in turn for a second each; starts upwards from zero."""
        wave = 0.5 - 2 * abs((since / 2 + 0.25) % 1.0 - 0.5)  # a triangle between -1/2 and 1/2, slopes of 1/s
        return np.clip(2 * wave / EDGE, -1.0, 1.0)

    shapes = {
        "healthy": lambda s, angle: 0.0,
        "bias": lambda s, angle: SIZE * min(s / EDGE, 1.0),
        "incipient": lambda s, angle: SIZE * s / (DURATION - ONSET),
        "loss": lambda s, angle: -0.2 * angle * min(s / EDGE, 1.0),
        "slow_sine": lambda s, angle: SIZE * np.sin(0.5 * s),
        "fast_sine": lambda s, angle: SIZE * np.sin(12.0 * s),
        "square": lambda s, angle: SIZE * square(s),
    }
    return lambda t, angle: shapes[kind](max(t - ONSET, 0.0), angle)


def wanted(t):
    """Angle that the motor is to take, rad: a slow sine, and steps every five seconds rounded over half a second."""
    steps = ((2.0, 0.3), (7.0, -0.5), (12.0, 0.4), (17.0, -0.4))  # s, rad
    steps = sum(size * np.clip((t - at) / 0.5, 0.0, 1.0) for at, size in steps)
    return 0.5 * np.sin(2 * np.pi * 0.15 * t) + steps


def move(kind):
    """One run with the loop closed through the sensors as they are; returns t, u, x, y, f and the friction moments.

    The voltage is that at the motor, behind the amplifier.  Noise has the same seed in every run.
    """
    model = mujoco.MjModel.from_xml_path(str(MODEL))
    data, acting, rng = mujoco.MjData(model), fault(kind), np.random.default_rng(SEED)
    noise, step = np.array(list(SENSORS.values())).T
    voltage, rows = 0.0, []
    for k in range(round(DURATION / HOLD) + 1):
        t, (motor, link), (motor_speed, link_speed) = k * HOLD, data.qpos, data.qvel
        f = acting(t, motor)
        y = np.array([motor + f, motor_speed, link]) + noise * rng.normal(size=3)
        y = np.round(y / step) * step
        rows.append([t, voltage, motor, motor_speed, link, link_speed / 10, *y, f, *data.qfrc_constraint])
        command = np.clip(KP * (wanted(t) - y[0]) - KD * y[1], -LIMIT, LIMIT)
        for _ in range(round(HOLD / model.opt.timestep)):
            voltage += (1 - np.exp(-model.opt.timestep / LAG)) * (command - voltage)
            data.ctrl[0] = voltage
            mujoco.mj_step(model, data)
    t, u, x, y, f, friction = np.split(np.array(rows), [1, 2, 6, 9, 10], axis=1)
    return t[:, 0], u[:, 0], x, y, f[:, 0], friction


def table(run):
    """One log as a table: what a recorder has, and the truth beside it."""
    t, u, x, y, f, _ = run
    columns = {"voltage": u, "true_f_motor_encoder": f} | dict(zip((f"true_x_{s}" for s in STATES), x.T, strict=True))
    columns = {name: np.round(v / FINE) * FINE + 0.0 for name, v in columns.items()}
    columns |= {"t": t.round(6)} | dict(zip(SENSORS, y.T + 0.0, strict=True))
    order = ["t", "voltage", *SENSORS, "true_f_motor_encoder", *(f"true_x_{s}" for s in STATES)]
    return pd.DataFrame(columns)[order].astype({name: "float32" for name in order if name != "t"})


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


def named(names, values):
    """Numbers by name, to three digits."""
    return {name: float(f"{v:.3g}") for name, v in zip(names, values, strict=True)}


def write_all(out):
    """Write the logs; the contents of the provenance file come back."""
    compact = {"index": False, "compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    logs = {}
    for kind in ("healthy", *TOLD):
        run = move(kind)
        frame = table(run)
        replace(out / f"{kind}.parquet", lambda name, frame=frame: frame.to_parquet(name, **compact))
        _, u, x, _, f, friction = run
        logs[kind] = {
            "fault": TOLD.get(kind), "fault_rms_rad": float(f"{np.sqrt((f**2).sum() / max((f != 0).sum(), 1)):.4g}"),
            "largest": named((*STATES, "voltage", "fault"), [*abs(x).max(0), abs(u).max(), abs(f).max()]),
            "friction_rms_N_m": named(("motor", "link"), np.sqrt((friction**2).mean(0))),
        }  # fmt: skip
    return {
        "simulator": "MuJoCo, two hinges and a tendon of our own (joint.xml)", "mujoco": version("mujoco"),
        "python": platform.python_version(), "numpy": version("numpy"), "pyarrow": version("pyarrow"),
        "script": "examples/flexible_joint/record.py", "model": "examples/flexible_joint/joint.xml",
        "log": {"sample_time_s": HOLD, "duration_s": DURATION, "onset_s": ONSET, "noise_seed": SEED,
                "noise_sd": {name: sd for name, (sd, _) in SENSORS.items()}},
        "loop": {"law": "command = kp (wanted - motor_encoder) - kd tacho", "kp": KP, "kd": KD, "amplifier_lag_s": LAG},
        "not_in_the_plant_file": {"friction_motor_N_m": 0.01, "friction_link_N_m": 0.003,
                                  "spring_damping_N_m_s": 0.0003},
        "logs": logs,
    }  # fmt: skip


def main():
    """Record everything into the folder given by --out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("src/faultrecon/data/flexible_joint"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(write_all(given.out), indent=1) + "\n"
    replace(given.out / "provenance.json", lambda name: Path(name).write_text(text, newline="\n"))


if __name__ == "__main__":
    main()
