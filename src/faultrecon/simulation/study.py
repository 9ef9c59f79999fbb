# SPDX-License-Identifier: BSD-3-Clause
"""Many seeded runs: every design on every scenario under every seed, and what the scores look like together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from faultrecon.finding import InputError
from faultrecon.plant.plant import Plant
from faultrecon.runtime.stepping import Hold, Scheme
from faultrecon.simulation.run import watch
from faultrecon.simulation.scenario import Scenario
from faultrecon.simulation.truth import true_run
from faultrecon.synthesis.result import Design

if TYPE_CHECKING:
    import pandas as pd

MEASURES = ("nrmse", "peak", "delay", "leak")
QUANTILES = (0.05, 0.95)


@dataclass(frozen=True, slots=True)
class Result:
    """The score of one fault in one run; achieved: the gain from disturbances to error, nan when nothing disturbs."""

    design: str
    scenario: str
    seed: int
    fault: str
    nrmse: float
    peak: float
    delay: float
    leak: float
    achieved: float


@dataclass(frozen=True)
class Study:
    """Every result of a study, in the order of scenarios, seeds, designs, faults."""

    results: tuple[Result, ...]

    def summary(self, quantiles: tuple[float, float] = QUANTILES) -> list[dict[str, Any]]:
        """Per scenario, design and fault: runs, and median, low and high quantile of each measure over the seeds.

        A delay that is infinite in some runs stays infinite in the quantiles it reaches; runs without a number are left
        out, and a measure without any is nan.
        """
        groups: dict[tuple[str, str, str], list[Result]] = {}
        for r in self.results:
            groups.setdefault((r.scenario, r.design, r.fault), []).append(r)
        rows = []
        for (scenario, design, fault), found in groups.items():
            row: dict[str, Any] = {"scenario": scenario, "design": design, "fault": fault, "runs": len(found)}
            for measure in MEASURES:
                values = np.array([getattr(r, measure) for r in found])
                row[measure] = _quantile(values, 0.5)
                row[f"{measure}_low"], row[f"{measure}_high"] = (_quantile(values, q) for q in quantiles)
            rows.append(row)
        return rows

    def to_table(self) -> pd.DataFrame:
        """Every result as a row of a table."""
        import pandas as pd

        return pd.DataFrame([asdict(r) for r in self.results])

    def __str__(self) -> str:
        rows = self.summary()
        width = {k: max([len(k), *(len(str(r[k])) for r in rows)]) for k in ("scenario", "design", "fault")}
        head = "  ".join(f"{k:{w}}" for k, w in width.items()) + f"  {'runs':>4}"
        lines = [head + "".join(f"  {m:>10} {'5 %':>9} {'95 %':>9}" for m in MEASURES)]
        for r in rows:
            numbers = "".join(f"  {r[m]:10.4g} {r[f'{m}_low']:9.4g} {r[f'{m}_high']:9.4g}" for m in MEASURES)
            lines.append("  ".join(f"{r[k]:{w}}" for k, w in width.items()) + f"  {r['runs']:4d}" + numbers)
        return "\n".join(lines)


def study(
    designs: Mapping[str, Design],
    scenarios: Sequence[Scenario],
    *,
    seeds: Sequence[int] = (0,),
    hold: Hold = "linear",
    scheme: Scheme = "auto",
    plant: Plant | None = None,
    progress: Callable[[float], None] | None = None,
) -> Study:
    """Run every design on every scenario under every seed; designs for one plant see the same truth.

    designs: by the name to show.  plant: what is simulated when it is not each design's own.  progress: told the part
    done, 0 to 1.  Raises InputError when there is nothing to run.
    """
    if not designs or not scenarios or not seeds:
        raise InputError("there is nothing to study", remedies=("give designs, scenarios and seeds",))
    results: list[Result] = []
    total, done = len(scenarios) * len(seeds), 0
    for number, scenario in enumerate(scenarios):
        name = scenario.name or f"scenario {number + 1}"
        for seed in seeds:
            truths = {}
            for label, design in designs.items():
                model = plant or design.plant
                key = model.digest()
                if key not in truths:
                    truths[key] = true_run(model, scenario.with_seed(seed))
                score = watch(design, truths[key], hold=hold, scheme=scheme).score()
                gain = float("nan") if score.achieved is None else score.achieved
                results += [
                    Result(label, name, seed, fault, s.nrmse, s.peak, s.delay, s.leak, gain)
                    for fault, s in score.items()
                ]
            done += 1
            if progress is not None:
                progress(done / total)
    return Study(tuple(results))


def _quantile(values: Any, q: float) -> float:
    """The quantile of the numbers that are there; nearest, so that an infinite one does not spoil its neighbours."""
    known = values[~np.isnan(values)]
    return float(np.quantile(known, q, method="nearest")) if known.size else float("nan")
