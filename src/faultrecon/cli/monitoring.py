# SPDX-License-Identifier: BSD-3-Clause
"""The verbs `design --bank` and `run` on a bank: which of all the sensors is lying."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from faultrecon.cli.keeping import Keeping, large, run_pieces
from faultrecon.finding import InputError
from faultrecon.io.bankfile import read_bank, write_bank
from faultrecon.io.designfile import target
from faultrecon.io.running import Make
from faultrecon.plant.plant import Plant
from faultrecon.plant.signals import Signals
from faultrecon.synthesis.bank import Bank, bank

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from faultrecon.io.watched import Watched


def make_bank(
    plant: Plant,
    out: Path | None,
    faults: Sequence[str] | None,
    actuators: Sequence[str],
    together: Sequence[str],
    say: Callable[[str], None],
    **options: Any,
) -> tuple[dict[str, Any], str]:
    """A design for each hypothesis, written to `out`; the summary as data and as text.

    faults: declared faults, sensors and inputs that may fail; by default every sensor and every declared actuator
    fault.  actuators: inputs that may fail too.  together: texts "a+b", faults that may act at once.  options: see
    `bank`.
    """
    if out is not None:
        target(out)
    sets = [tuple(name.strip() for name in text.split("+")) for text in together]
    for text, names in zip(together, sets, strict=True):
        if len(names) < 2 or not all(names):
            raise InputError(f"--together '{text}'", why="it names two or more faults, as in pitch_rate+roll_rate")
    declared = [name for f in plant.faults if f.site == "actuator" and faults is None for name in f.on]
    more = list(dict.fromkeys([*actuators, *declared])) if actuators else None
    made = bank(plant, faults=faults or None, actuators=more, together=sets, progress=say, **options)
    if out is not None:
        write_bank(made, out)
    where = f"\nwrote {out}" if out is not None else "\nnothing written; add --out bank.json"
    say("what is told apart")
    return made.as_dict() | {"written": None if out is None else str(out)}, made.report() + where


def run_bank(
    file: str,
    log: str,
    out: Path | None,
    figure: Path | None,
    plant: Plant | None,
    mapping: Mapping[str, str],
    options: Mapping[str, Any],
    keeping: Keeping,
    progress: Callable[[float], None],
) -> tuple[dict[str, Any], str]:
    """A log through the bank in `file`; the summary as data and as text.

    A piece at a time with a checkpoint or for a large file, like a design.  options: sample_time, and those of
    `supervised`.
    """
    from faultrecon.io.logs import write_log
    from faultrecon.io.watched import watch

    made = read_bank(file, plant)
    if keeping.checkpoint is not None or (figure is None and large(log)):
        return _in_pieces(made, log, out, mapping, options, keeping, progress)
    done = watch(made, log, mapping=mapping or None, progress=progress, **options)
    if figure is not None:
        from faultrecon.plot.figures import save

        save(_figure(done, plant or made.plant), figure)
    if out is not None:
        write_log(out, done.columns())
    return _said(done.as_dict(), str(done), out, figure)


def _in_pieces(
    made: Bank,
    log: str,
    out: Path | None,
    mapping: Mapping[str, str],
    options: Mapping[str, Any],
    keeping: Keeping,
    progress: Callable[[float], None],
) -> tuple[dict[str, Any], str]:
    from faultrecon.io.chunks import Pieces
    from faultrecon.io.plausibility import unit_doubts_of
    from faultrecon.io.watched import TRUTH, monitoring
    from faultrecon.runtime.supervision import Supervision

    done = run_pieces(
        monitoring(made, **options), made.plant.signals, log, out, mapping, keeping, progress, as_it_came=True
    )
    supervision, state = done.processor, done.state
    assert isinstance(supervision, Supervision), "a bank makes nothing else"
    events, counts = supervision.monitor.events(state.monitor), state.counts
    notes = [*unit_doubts_of(made.plant, done.survey.interval, done.survey.spans)]
    if known := [name for name in Pieces(log).names if name.startswith(TRUTH)]:
        notes.append(f"{', '.join(known)}: a log is not scored a piece at a time; for scores, run a part of it whole")
    data = {
        "rows": done.tally.written,
        "events": [event.as_dict() for event in events],
        "counts": counts.as_dict(supervision.intake.names),
        "untested": {name: finding.as_dict() for name, finding in supervision.monitor.refused.items()},
        "notes": notes,
        "resumed_at": done.resumed_at,
    }
    lines = [f"{log}: {counts.received} rows in, {done.tally.written} out, a piece at a time"]
    lines += [f"  went on at row {done.resumed_at + 1}"] if done.resumed_at else []
    lines += [f"  {finding}" for finding in supervision.intake.findings(counts)]
    lines += [f"  not tested: {name}; {finding}" for name, finding in supervision.monitor.refused.items()]
    lines += [f"  {event}" for event in events if event.mode != "warming"]
    lines += [f"  note: {note}" for note in notes]
    return _said(data, "\n".join(lines), out, None)


def _said(data: dict[str, Any], text: str, out: Path | None, figure: Path | None) -> tuple[dict[str, Any], str]:
    written = {"written": None if out is None else str(out), "figure": None if figure is None else str(figure)}
    return data | written, "\n".join([text, *(f"  wrote {path}" for path in (out, figure) if path is not None)])


def _figure(done: Watched, plant: Plant) -> Figure:
    """The single faults of a watched log, in the units of what they sit on."""
    from faultrecon.plot.watching import watched_figure

    units = dict(zip(plant.signals.y.names, plant.signals.y.units, strict=True))
    units |= dict(zip(plant.signals.u.names, plant.signals.u.units, strict=True))
    faults = {h.faults[0]: h.watch.plant.faults[0] for h in done.monitor.hypotheses if len(h.faults) == 1}
    return watched_figure(done.table, list(faults), [units.get(next(iter(f.on)), "") for f in faults.values()])


def bank_stream(file: str, plant: Plant | None, options: Mapping[str, Any]) -> tuple[Make, Signals]:
    """What answers a stream with the decisions of a bank."""
    from faultrecon.io.watched import monitoring

    made = read_bank(file, plant)
    return monitoring(made, **options), made.plant.signals
