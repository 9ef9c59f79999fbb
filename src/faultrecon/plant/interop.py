# SPDX-License-Identifier: BSD-3-Clause
"""Plants from and to what control engineers have on their desks: python-control and scipy.signal.

What the other side can hold goes over and comes back: A, B, C, D and the sample time to the last bit, in python-control
also names and units (a label reads "pitch_rate [rad/s]").  What it cannot hold is told, in a `FindingWarning`; a plant
with a nonlinear part is refused, because its matrices alone are another plant.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from faultrecon.finding import Finding, InputError, MissingExtra
from faultrecon.plant.fault import Disturbance, FaultChannel
from faultrecon.plant.matrices import (
    Group,
    demand_distinct,
    groups_of,
    input_columns,
    left_behind,
    plant_from_matrices,
    plant_matrices,
    split,
    tell,
)
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import NAME, Noise

if TYPE_CHECKING:
    import control

NUMBERED = re.compile(r"([A-Za-z_]\w*)\[(\d+)\]")  # the labels that python-control makes up: x[0], x[1], ...


def plant_to_control(plant: Plant, *, inputs: Sequence[Group] = ("u",), units: bool = True) -> control.StateSpace:
    """The plant as a `control.StateSpace` with its name, its labels and its sample time (dt = 0: continuous).

    inputs: which groups become inputs, see `plant_matrices`.  units: labels "name [unit]", else bare names.
    Warns with a `FindingWarning` of what a StateSpace cannot hold.  Raises MissingExtra without python-control, and
    InputError for a nonlinear plant or one without a single input.
    """
    control = _control()
    A, B, C, D = plant_matrices(plant, inputs=inputs)
    if B.shape[1] == 0:
        raise InputError(
            f"{plant.name} has no input among {', '.join(inputs)}",
            why="python-control takes systems with one input at least",
            remedies=('add inputs=("disturbances",)', "use plant_to_scipy"),
        )
    s = plant.signals
    labels = [label for group in groups_of(inputs) for label in input_columns(plant, group)[2]]
    demand_distinct(labels)
    texts = {"inputs": labels, "outputs": s.y.texts(), "states": s.x.texts()}
    held = {k: [_label(text, units) for text in several] for k, several in texts.items()}
    lost = [
        text
        for k, several in texts.items()
        for text, now in zip(several, held[k], strict=True)
        if units and text != now
    ]
    dt = 0 if plant.sample_time is None else plant.sample_time
    system = control.StateSpace(A, B, C, D, dt, name=plant.name, remove_useless_states=False, **held)
    renamed = Finding(
        f"python-control has no '.' in labels: {', '.join(lost)}",
        why="units are left out there and names written with '_'",
        severity="warning",
    )
    tell([*([renamed] if lost else []), *left_behind(plant, inputs)])
    return system


def plant_to_scipy(plant: Plant, *, inputs: Sequence[Group] = ("u",)) -> Any:
    """The plant as a `scipy.signal.StateSpace`, continuous or with dt; inputs: see `plant_matrices`.

    It has no names: order is all.  Warns with a `FindingWarning` of what else it cannot hold.
    """
    from scipy import signal

    A, B, C, D = plant_matrices(plant, inputs=inputs)
    tell(left_behind(plant, inputs))
    return signal.StateSpace(A, B, C, D, **({} if plant.sample_time is None else {"dt": plant.sample_time}))


def plant_from_control(
    system: Any,
    *,
    name: str | None = None,
    faults: Sequence[FaultChannel | str] = (),
    disturbances: Sequence[Disturbance | str] = (),
    noise: Noise | None = None,
    operating_point: OperatingPoint | None = None,
) -> Plant:
    """A plant from a `control.StateSpace`; labels "name [unit]" give names and units, x[0] becomes x1.

    faults, disturbances: channels, or names of inputs and sensors as in `plant_from_matrices`.  A transfer function is
    realised first.  Warns with a `FindingWarning` of labels that had to be changed and of states without a meaning.
    Raises InputError for a system that is not linear or whose time base is not specified.
    """
    control = _control()
    realised = isinstance(system, control.TransferFunction)
    if realised:
        system = _realised(lambda: control.ss(system))
    if not isinstance(system, control.StateSpace):
        raise InputError(
            f"a {type(system).__name__} is no linear system of python-control",
            remedies=("give a StateSpace or a TransferFunction", "system.linearize(x, u) of a nonlinear one"),
        )
    chosen = {text for text in (*faults, *disturbances) if isinstance(text, str)}
    renamed: list[str] = []
    labels = {
        group: _own_names(several, group, chosen if group == "u" else set(), renamed)
        for group, several in (("x", system.state_labels), ("u", system.input_labels), ("y", system.output_labels))
    }
    changed = Finding(
        f"labels were changed: {', '.join(renamed)}",
        why="a signal name has letters, digits and _",
        remedies=("rename them first: system.update_names(...)",),
        severity="warning",
    )
    tell([*([changed] if renamed else []), *([_MEANINGLESS] if realised else [])])
    return plant_from_matrices(
        system.A,
        system.B,
        system.C,
        system.D,
        sample_time=_sample_time(system.dt, "system.dt = 0 for continuous time, or the sample time in seconds"),
        name=name or system.name,
        states=labels["x"],
        inputs=labels["u"],
        outputs=labels["y"],
        faults=faults,
        disturbances=disturbances,
        noise=noise,
        operating_point=operating_point,
        source="converted from python-control",
    )


def plant_from_scipy(system: Any, **declared: Any) -> Plant:
    """A plant from a `scipy.signal` system, or from (A, B, C, D) or (A, B, C, D, dt).

    declared: name, states, inputs, outputs, faults, disturbances, noise, operating_point as in `plant_from_matrices`.
    A transfer function is realised first, and a `FindingWarning` says that its states have no meaning.
    """
    from scipy import signal

    if isinstance(system, tuple | list):
        if len(system) not in (4, 5):
            raise InputError(
                f"a plant is made of (A, B, C, D) or (A, B, C, D, dt), not of {len(system)} parts",
                remedies=("realise a transfer function first: scipy.signal.lti(num, den).to_ss()",),
            )
        *matrices, dt = system if len(system) == 5 else (*system, 0)
        return plant_from_matrices(*matrices, sample_time=_sample_time(dt, "give dt in seconds"), **declared)
    if not isinstance(system, signal.lti | signal.dlti):
        raise InputError(
            f"a {type(system).__name__} is no system of scipy.signal", remedies=("give a scipy.signal.StateSpace",)
        )
    found: Any = system
    if not isinstance(found, signal.StateSpace):
        found = _realised(found.to_ss)
        tell([_MEANINGLESS])
    time = _sample_time(0 if found.dt is None else found.dt, "give dt in seconds: StateSpace(A, B, C, D, dt=0.01)")
    declared = {"source": "converted from scipy.signal"} | declared
    parts: list[Any] = [found.A, found.B, found.C, found.D]
    return plant_from_matrices(*parts, sample_time=time, **declared)


_MEANINGLESS = Finding(
    "a transfer function was realised",
    why="the states of that realisation are no physical quantities",
    remedies=("give the state space model if there is one",),
    severity="warning",
)


def _control() -> Any:
    try:
        import control
    except ImportError as error:
        raise MissingExtra("python-control", "interop") from error
    return control


def _realised(realise: Callable[[], Any]) -> Any:
    try:
        return realise()
    except Exception as error:  # what these libraries raise here has no common base
        raise InputError("the transfer function cannot be realised", why=f"{type(error).__name__}: {error}") from error


def _sample_time(dt: Any, remedy: str) -> float | None:
    """None for continuous time.  Raises InputError for a time base that is left open."""
    if dt is None or dt is True:
        raise InputError(f"the time base is not specified (dt = {dt})", remedies=(f"set {remedy}",))
    return None if dt == 0 else float(dt)


def _own_names(labels: Sequence[str], group: str, chosen: set[str], renamed: list[str]) -> list[str]:
    """Labels as declarations that a plant takes; those in `chosen` become channels and keep their names."""
    texts = []
    for label in labels:
        made_up = NUMBERED.fullmatch(label)
        ((name, unit),) = split([f"{made_up[1]}{int(made_up[2]) + 1}" if made_up else label])
        if name not in chosen and label not in chosen and (not NAME.fullmatch(name) or name in ("t", "time")):
            legal = re.sub(r"\W", "_", name, flags=re.ASCII)
            legal = legal if NAME.fullmatch(legal) and legal not in ("t", "time") else f"{group}_{legal}"
            renamed.append(f"'{name}' is now '{legal}'")
            name = legal
        texts.append(f"{name} [{unit}]" if unit else name)
    if len({name for name, _ in split(texts)}) < len(texts):
        renamed.append(f"{group} is numbered, because two labels would read alike")
        return [f"{group}{k + 1}" for k in range(len(labels))]
    return texts


def _label(text: str, units: bool) -> str:
    """A label without '.', which python-control keeps for "system.signal"."""
    if units and "." not in text:
        return text
    return re.sub(r"\s*\[[^\[\]]*\]$", "", text).replace(".", "_")
