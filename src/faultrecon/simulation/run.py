# SPDX-License-Identifier: BSD-3-Clause
"""A design put to work on a simulated plant whose faults are known, and how well it did."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from faultrecon.finding import InputError, did_you_mean
from faultrecon.methods.base import Method
from faultrecon.methods.registry import method as method_named
from faultrecon.plant.fault import Disturbance
from faultrecon.plant.plant import Plant
from faultrecon.runtime.samples import Trace
from faultrecon.runtime.stepping import Hold, Scheme
from faultrecon.simulation.metrics import FaultScore, scores
from faultrecon.simulation.scenario import Scenario, default_sample_time
from faultrecon.simulation.truth import Truth, true_run
from faultrecon.synthesis.certify import gains_from
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Array = NDArray[Any]


@dataclass(frozen=True)
class Score(Mapping[str, FaultScore]):
    """The four numbers per fault, by name, and the gain reached beside the level that is certified.

    achieved: sqrt(∫|f - f̂|² / (∫|w|² + V(e(0))/γ²)) over the run, in declared sizes, sensor noise counted in w; None
    when nothing disturbs, or when noise acts that is no declared disturbance.  level: the certified γ, or None.
    outside: why the certificate does not cover this run, empty when it does (up to sampling, which no certificate
    covers).  undeclared: the sensors whose noise acts and is none of the disturbances.  level_of: "deviation" where the
    level bounds a standard deviation under white noise, with which no single run can be compared.
    """

    faults: Mapping[str, FaultScore]
    achieved: float | None
    level: float | None
    outside: tuple[str, ...] = ()
    undeclared: tuple[str, ...] = ()
    level_of: str = "gain"

    def __getitem__(self, name: str) -> FaultScore:
        if name not in self.faults:
            raise InputError(f"there is no fault '{name}'", why=did_you_mean(name, self.faults))
        return self.faults[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.faults)

    def __len__(self) -> int:
        return len(self.faults)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "faults": {name: found.as_dict() for name, found in self.faults.items()},
            "achieved": self.achieved,
            "level": self.level,
            "outside": list(self.outside),
            "noise_not_declared": list(self.undeclared),
        }

    def __str__(self) -> str:
        width = max([5, *(len(name) for name in self.faults)])
        lines = [f"{'fault':{width}} {'nrmse':>9} {'peak':>10} {'delay [s]':>10} {'leak':>10}"]
        for name, s in self.faults.items():
            rest = " ".join(f"{_number(v, '.4g'):>10}" for v in (s.peak, s.delay, s.leak))
            lines.append(f"{name:{width}} {_number(s.nrmse, '.4f'):>9} {rest}")
        level = "none" if self.level is None else f"{self.level:.6g}"
        if self.level_of == "deviation":
            lines.append(f"certified: error deviation up to {level} under white noise of the declared sizes")
            return "\n".join([*lines, *(f"  not covered by the certificate: {reason}" for reason in self.outside)])
        lines.append(f"gain from disturbances to error: {self._gain()}; certified {level}")
        lines += [f"  not covered by the certificate: {reason}" for reason in self.outside]
        return "\n".join(lines)

    def _gain(self) -> str:
        if self.achieved is not None:
            return f"achieved {self.achieved:.4g}"
        if self.undeclared:
            return f"not comparable: {undeclared_noise(self.undeclared)}; --no-noise compares"
        return "nothing disturbs: no gain to compare" if not self.outside else "no gain to compare"


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """A design, a scenario, what the plant did and what was reconstructed from u and y alone.

    truth: see `Truth`.  trace: the estimates, see `Trace`.  The arrays have one row per sample; fault columns are those
    of the design, whose faults may be some of the plant's.
    """

    design: Design
    scenario: Scenario
    truth: Truth
    trace: Trace

    @property
    def t(self) -> Array:
        """Sampling times (N,), s."""
        return self.truth.t

    @property
    def u(self) -> Array:
        """Inputs (N, m), absolute."""
        return self.truth.u

    @property
    def y(self) -> Array:
        """Measurements (N, p), faults and noise included."""
        return self.truth.y

    @property
    def x(self) -> Array:
        """True states (N, n)."""
        return self.truth.x

    @property
    def f(self) -> Array:
        """True faults (N, q), those that the design reconstructs."""
        names = [f.name for f in self.truth.plant.faults]
        return self.truth.f[:, [names.index(f.name) for f in self.design.plant.faults]]

    @property
    def x_hat(self) -> Array:
        """Reconstructed states (N, n)."""
        return self.trace.state

    @property
    def f_hat(self) -> Array:
        """Reconstructed faults (N, q)."""
        return self.trace.fault

    @property
    def corrected(self) -> Array:
        """Measurements with the reconstructed faults taken out, (N, p)."""
        return self.trace.corrected

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which measurements were usable, (N, p)."""
        return self.trace.ok

    def score(self) -> Score:
        """nrmse, peak, delay and leak per fault, and the gain reached against the certified level."""
        names = tuple(f.name for f in self.design.plant.faults)
        found = scores(self.t, self.f, self.f_hat, names)
        if self._level_of == "deviation":
            return Score(found, None, self.design.level, self._outside, level_of="deviation")
        return Score(found, self._achieved, self.design.level, self._outside, self._counted_noise[1])

    @property
    def _level_of(self) -> str:
        return self._method.level_of

    @property
    def _method(self) -> Method:
        return method_named(self.design.method)

    @cached_property
    def _counted_noise(self) -> tuple[Array, tuple[str, ...]]:
        """Sensor noise as counted disturbances (N, l), and the sensors whose noise is none of them.

        Noise is counted where a disturbance enters its sensor and nothing else; of several the one that costs least,
        since the level holds for every way to explain what the sensor showed.
        """
        counted = self._method.counted(self.design.plant) or ()
        out, undeclared = np.zeros((len(self.t), len(counted))), []
        for j, sensor in enumerate(self.design.plant.signals.y):
            if not self.truth.noise[:, j].any():
                continue
            reach = {k: abs(d.on[sensor]) * d.size for k, d in enumerate(counted) if _enters_only(d, sensor)}
            if reach:
                k = max(reach, key=reach.__getitem__)
                out[:, k] += self.truth.noise[:, j] / counted[k].on[sensor]
            else:
                undeclared.append(sensor)
        return out, tuple(undeclared)

    @cached_property
    def _achieved(self) -> float | None:
        plant = self.design.plant
        counted = self._method.counted(plant)
        noise, undeclared = self._counted_noise
        if undeclared or counted is None:
            return None
        names = [d.name for d in self.truth.plant.disturbances]
        w = self.truth.w[:, [names.index(d.name) for d in counted]] if counted else self.truth.w[:, :0]
        size = np.array([f.size for f in plant.faults])
        effort = _energy(self.t, (w + noise) / np.array([d.size for d in counted]))
        if self._method.counts_rates:  # of the straight lines between the samples
            effort += float(np.sum(np.square(np.diff(self.f / size, axis=0)) / np.diff(self.t)[:, None]))
        error = _energy(self.t, (self.f - self.f_hat) / size)
        start = initial_cost(self.design, self.x[0] - self.truth.x_hat0)
        if start and self.design.level is not None:
            effort += start / self.design.level**2
        return math.sqrt(error / effort) if effort > 0 else None

    @cached_property
    def _outside(self) -> tuple[str, ...]:
        design, truth = self.design, self.truth
        if design.certificate is None:
            return ("there is none",)
        found = []
        if self._counted_noise[1] and self._level_of == "gain":
            found.append(undeclared_noise(self._counted_noise[1]))
        if truth.plant.with_faults([f.name for f in design.plant.faults]).digest() != design.plant.digest():
            found.append("the plant that was simulated is not the plant of the design")
        names = {f.name for f in design.plant.faults}
        for j, f in enumerate(truth.plant.faults):
            if f.name not in names and truth.f[:, j].any():
                found.append(f"the fault {f.name} acts and is none of the design's")
        counted = self._method.counted(design.plant)
        if counted is None:
            found.append("the level is another than that from disturbances to this error: see the claim")
        names_counted = {d.name for d in counted or ()}
        for j, d in enumerate(truth.plant.disturbances):
            if d.name not in names_counted and truth.w[:, j].any():
                found.append(f"{d.name} acts, which is no disturbance that the level counts")
        found += [f"the plant leaves the declared domain of {name}" for name in truth.left_domain()]
        return tuple(found) + self._left_box

    @property
    def _left_box(self) -> tuple[str, ...]:
        """What leaves the box of a polytopic form, true or estimated: there its vertices say nothing."""
        form = self.design.plant.polytopic
        if form is None:
            return ()
        signals = self.design.plant.signals
        names = [f.name for f in self.design.plant.faults]
        value = dict(zip(signals.x, self.x.T, strict=True)) | dict(zip(signals.u, self.u.T, strict=True))
        value |= dict(zip(names, self.f.T, strict=True))
        guess = dict(zip(signals.x, self.x_hat.T, strict=True)) | dict(zip(names, self.f_hat.T, strict=True))
        return tuple(
            f"the {what} leaves the box of the polytopic form" for what in form.left(value=value, estimate=guess)
        )

    def columns(self) -> dict[str, Array]:
        """Like a log with its truth: t, inputs, measurements, true_f_<fault>, f_<fault>, <sensor>_corrected and _ok."""
        plant = self.design.plant
        table: dict[str, Array] = {"t": self.t}
        table |= {name: self.u[:, j] for j, name in enumerate(plant.signals.u)}
        table |= {name: self.y[:, j] for j, name in enumerate(plant.signals.y)}
        table |= {f"true_f_{f.name}": self.f[:, j] for j, f in enumerate(plant.faults)}
        table |= {f"f_{f.name}": self.f_hat[:, j] for j, f in enumerate(plant.faults)}
        reached = {name for f in plant.faults if f.site == "sensor" for name in f.on}
        for j, name in enumerate(plant.signals.y):
            if name in reached:
                table[f"{name}_corrected"] = self.corrected[:, j]
        table |= {f"{name}_ok": self.ok[:, j] for j, name in enumerate(plant.signals.y)}
        return table

    def to_table(self) -> pd.DataFrame:
        """`columns` as a table."""
        import pandas as pd

        return pd.DataFrame(self.columns())

    def plot(self, *, title: str | None = None) -> Figure:
        """The faults as they were and as they were found, and the sensors before and after correction."""
        # Drawing lies above simulation; this one method reaches up so that a run can be looked at in a notebook.
        from faultrecon.plot.gallery import run_figure

        return run_figure(self, title=title)

    def __repr__(self) -> str:
        found = scores(self.t, self.f, self.f_hat, tuple(f.name for f in self.design.plant.faults))
        words = ", ".join(
            f"{name} nrmse {s.nrmse:.3g}" if math.isfinite(s.nrmse) else f"{name} leak {s.leak:.3g}"
            for name, s in found.items()
        )
        about = self.scenario.name or "scenario"
        return f"Run({self.design.method!r} on {self.truth.plant.name!r}, {about}: {len(self.t)} samples; {words})"


def simulate(
    design: Design,
    scenario: Scenario,
    *,
    hold: Hold = "linear",
    scheme: Scheme = "auto",
    plant: Plant | None = None,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Let a scenario happen to the plant and reconstruct it with the design.

    hold, scheme: how the estimator reads samples in between and integrates, see `Estimator.build`.  plant: the plant
    that is simulated when it is not the design's own: more faults, or a model that is wrong on purpose.
    Raises InputError on names nobody declared and on a step beyond the stability limit, before anything runs.
    """
    model = plant or design.plant
    _same_signals(design.plant, model)
    sample_time = scenario.sample_time or default_sample_time(model)
    estimator = design.estimator(sample_time, hold=hold, scheme=scheme)
    truth = true_run(model, scenario)
    return Run(design, scenario, truth, estimator.replay(truth.t, truth.u, truth.y, x=truth.x_hat0, progress=progress))


def watch(design: Design, truth: Truth, *, hold: Hold = "linear", scheme: Scheme = "auto") -> Run:
    """Reconstruct what has been simulated already: several designs on the same truth."""
    _same_signals(design.plant, truth.plant)
    interval = float(truth.t[1] - truth.t[0])
    trace = design.estimator(interval, hold=hold, scheme=scheme).replay(truth.t, truth.u, truth.y, x=truth.x_hat0)
    return Run(design, truth.scenario, truth, trace)


def initial_cost(design: Design, error: Array) -> float | None:
    """V(e(0)) = e'P e with the certificate's P, in units of squared fault error times seconds; None without one."""
    if design.certificate is None or not {"P", "T⁻¹", "U"} <= design.certificate.data.keys():
        return None
    found = gains_from({name: design.certificate.data[name] for name in ("P", "T⁻¹", "U")})
    scaled = found["T⁻¹"] @ error
    return float(scaled @ found["P"] @ scaled) / float(found["U"].item()) ** 2


def undeclared_noise(sensors: Sequence[str]) -> str:
    """Why the gain that was reached cannot be held against the level."""
    return f"noise of {', '.join(sensors)} acts and is not among the disturbances"


def _enters_only(d: Disturbance, sensor: str) -> bool:
    return not any(d.into.values()) and [name for name, c in d.on.items() if c] == [sensor]


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else f"{value:{form}}"


def _energy(t: Array, values: Array) -> float:
    """∫|values|² dt by the trapezoidal rule; values (N, k)."""
    squared = np.sum(np.square(values), axis=1) if values.size else np.zeros(len(t))
    return float(np.sum(0.5 * (squared[1:] + squared[:-1]) * np.diff(t)))


def _same_signals(design: Plant, model: Plant) -> None:
    for group in ("x", "u", "y"):
        ours, theirs = (getattr(p.signals, group).names for p in (design, model))
        if ours != theirs:
            raise InputError(
                f"the plant to simulate has {group} = {', '.join(theirs)}", why=f"the design has {', '.join(ours)}"
            )
    missing = {f.name for f in design.faults} - {f.name for f in model.faults}
    missing |= {d.name for d in design.disturbances} - {d.name for d in model.disturbances}
    if missing:
        raise InputError(f"the plant to simulate has no {', '.join(sorted(missing))}", why="the design has")
