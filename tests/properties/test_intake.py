# SPDX-License-Identifier: BSD-3-Clause
"""Whatever arrives, and however it is cut into pieces: the same rows come out, in order, and each is accounted for."""

import math
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultrecon.runtime.intake import Intake, IntakeState, Taken
from faultrecon.runtime.intake_counts import PER_CHANNEL, Counts, Flag
from faultrecon.runtime.intake_order import Fate
from faultrecon.runtime.intake_watch import Watch, independent

U = (Watch("valve", 0.0, 1.0),)
Y = (Watch("level", -1.0, 2.0, sd=0.5, hold=0.5, still=3), Watch("flow", sd=0.25, hold=0.25))
NAN, INF = math.nan, math.inf
TIMES = st.sampled_from([*(0.5 * k for k in range(14)), 0.6, -3.0, -0.0, NAN, INF, -INF, 1e18, -1e308, 1e308])
VALUES = st.sampled_from([NAN, NAN, 0.0, -0.0, 0.25, 0.75, 1.0, 2.0, 2.0, 2.5, -1.0, INF, -INF, 1e308])
ROWS = st.lists(st.tuples(TIMES, VALUES, VALUES, VALUES), max_size=40)
INTAKES = st.builds(
    Intake,
    st.just(0.5),
    st.just(U),
    st.just(Y),
    st.sampled_from([0.0, 1e-9, 0.5, 1.2, INF]),
    st.sampled_from([INF, 2.0, 20.0]),
)


def arrays(rows):
    x = np.array(rows, dtype=float).reshape(-1, 4)
    return x[:, 0], x[:, 1:2], x[:, 2:]


def in_pieces(intake, rows, cuts, *, state=None):
    """All that comes out when the arrivals are cut at these places, and the state before and after the flush."""
    t, u, y = rows
    state, out = state or intake.init(), []
    edges = [0, *sorted(cuts), len(t)]
    for a, b in pairwise(edges):
        state, taken = intake.take(state, t[a:b], u[a:b], y[a:b])
        out.append(taken)
    after, last = intake.flush(state)
    return out[0].followed_by(*out[1:], last), state, after


def same(a, b):
    for one in fields(Taken):
        left, right = getattr(a, one.name), getattr(b, one.name)
        if one.name == "counts":
            assert left == right
        else:
            assert left.dtype == right.dtype and np.array_equal(left, right, equal_nan=left.dtype == float), one.name
            if left.dtype == float:
                assert np.array_equal(np.signbit(left[left == 0]), np.signbit(right[right == 0])), one.name


# ---------------------------------------------------------------- the rules once more, a row at a time


class Slowly:
    """What the intake promises, in the plainest words."""

    def __init__(self, intake):
        self.intake, self.waiting, self.out = intake, [], []
        self.newest, self.left, self.doubted, self.last = -INF, -INF, NAN, [NAN] * 3
        self.c = dict.fromkeys(("received", "passed", "merged", "duplicates", "late", "bad_time", "reordered"), 0)
        self.lateness, self.conflicts, self.fates = 0.0, [0, 0, 0], []

    def arrive(self, t, *x):
        before = self.c.copy()
        self.goes_in(t, x)
        told = {"merged": Fate.MERGED, "duplicates": Fate.DUPLICATE, "late": Fate.LATE, "bad_time": Fate.BAD_TIME}
        self.fates.append(next((fate for name, fate in told.items() if self.c[name] > before[name]), Fate.PASSED))

    def goes_in(self, t, x):
        k, c = self.c["received"], self.c
        c["received"] += 1
        if not self.believes(t):
            c["bad_time"] += 1
            return
        if t <= self.left:
            self.too_late(t, x)
        else:
            c["reordered"] += t < self.newest
            row = next((row for row in self.waiting if row[0] == t), None)
            if row is None:
                self.waiting.append([t, k, list(x)])
                self.waiting.sort()
            else:
                self.join(row[2], x)
        self.newest = max(self.newest, t)
        while self.waiting and self.waiting[0][0] <= self.newest - self.intake.reorder:
            self.leave()

    def believes(self, t):
        if not math.isfinite(t):
            return False
        leap = self.intake.leap
        if leap < INF and self.newest > -INF and t - self.newest > leap and not abs(t - self.doubted) <= leap:
            self.doubted = t
            return False
        self.doubted = NAN
        return True

    def too_late(self, t, x):
        came = [j for j in range(3) if not math.isnan(x[j])]
        if t == self.left and all(x[j] == self.last[j] for j in came):
            self.c["duplicates"] += 1
            return
        self.c["late"] += 1
        self.lateness = max(self.lateness, self.newest - t)
        for j in came:
            self.conflicts[j] += t == self.left and not math.isnan(self.last[j]) and x[j] != self.last[j]

    def join(self, values, x):
        news = False
        for j in range(3):
            if math.isnan(x[j]):
                continue
            if math.isnan(values[j]):
                values[j], news = x[j], True
            elif values[j] != x[j]:
                self.conflicts[j] += 1
                news = True
        self.c["merged" if news else "duplicates"] += 1

    def leave(self):
        t, k, x = self.waiting.pop(0)
        self.left, self.last = t, x
        self.c["passed"] += 1
        self.out.append((t, k, x))


def judged(watch, times, values):
    """The flag of every value of one channel, in the plainest words."""
    flags, last, run, since, step, side, touching = [], NAN, 0, NAN, INF, 0, 0
    tol = 1e-6 * (watch.high - watch.low) if math.isfinite(watch.high - watch.low) else 0.0
    for t, x in zip(times, values, strict=True):
        if math.isnan(x):
            flags.append(Flag.MISSING)
            continue
        beyond = not watch.low - tol <= x <= watch.high + tol or math.isinf(x)
        now = 0 if beyond else int(x >= watch.high - tol) - int(x <= watch.low + tol)
        touching = 0 if now == 0 else touching + 1 if now == side else 1
        side = now
        if x != last:
            if not math.isnan(last) and watch.still is None and watch.sd:
                step = min(step, max(abs(x - last), 0.15 * watch.sd))
            last, run, since = x, 0, t
        run += 1
        K = independent(math.sqrt(12) if step == INF else step / watch.sd) if watch.sd else 0
        enough = run >= max(20, K) and t - since >= (K - 0.5) * watch.hold and watch.sd > 0
        frozen = run >= watch.still if watch.still else enough
        flags.append(
            Flag.OUT_OF_LIMITS
            if beyond
            else Flag.SATURATED
            if touching >= watch.touches
            else Flag.FROZEN
            if frozen
            else Flag.GOOD
        )
    return flags


def agrees_with_the_plain_rules(intake, rows, taken):
    slow = Slowly(intake)
    for t, u, y in zip(rows[0].tolist(), rows[1].tolist(), rows[2].tolist(), strict=True):
        slow.arrive(t, *u, *y)
    while slow.waiting:
        slow.leave()
    c = taken.counts
    assert {name: getattr(c, name) for name in slow.c} == slow.c
    assert taken.fates.tolist() == slow.fates
    assert c.lateness == slow.lateness and list(c.conflicts) == slow.conflicts
    assert taken.t.tolist() == [t for t, _, _ in slow.out] and taken.arrival.tolist() == [k for _, k, _ in slow.out]
    x = np.array([x for _, _, x in slow.out], dtype=float).reshape(-1, 3)
    flags = np.hstack([taken.flags_u, taken.flags_y])
    for j, watch in enumerate((*intake.u, *intake.y)):
        assert flags[:, j].tolist() == judged(watch, taken.t.tolist(), x[:, j].tolist()), watch.name
    useless = np.isin(flags, (Flag.MISSING, Flag.OUT_OF_LIMITS, Flag.SATURATED))
    x[useless] = NAN
    assert np.array_equal(np.hstack([taken.u, taken.y]), x, equal_nan=True)


def adds_up(taken, waiting=0):
    c = taken.counts
    assert c.received == c.passed + c.merged + c.duplicates + c.late + c.bad_time + waiting
    for count, fate in zip((c.merged, c.duplicates, c.late, c.bad_time), list(Fate)[1:], strict=True):
        assert count == np.count_nonzero(taken.fates == fate)
    assert waiting or (taken.fates[taken.arrival] == Fate.PASSED).all()
    assert c.passed == len(taken) == len(taken.y) == len(taken.arrival)
    flags = np.hstack([taken.flags_u, taken.flags_y])
    for name, flag in (("missing", 1), ("out_of_limits", 2), ("saturated", 3), ("frozen", 4)):
        assert getattr(c, name) == tuple((flags == flag).sum(axis=0))
    assert c.gaps == np.count_nonzero(taken.lacking) and c.gap_rows == sum(map(int, taken.lacking.tolist()))


# ---------------------------------------------------------------- any arrivals


@settings(max_examples=400, deadline=None)
@given(INTAKES, ROWS)
def test_any_arrivals_come_out_as_the_plain_rules_say(intake, rows):
    taken = intake.whole(*arrays(rows))
    agrees_with_the_plain_rules(intake, arrays(rows), taken)
    adds_up(taken)
    assert np.all(taken.t[1:] > taken.t[:-1]) and np.isfinite(taken.t).all()


@settings(max_examples=400, deadline=None)
@given(INTAKES, ROWS, st.data())
def test_the_results_do_not_depend_on_how_the_arrivals_are_cut(intake, rows, data):
    cuts = data.draw(st.lists(st.integers(0, len(rows)), max_size=8))
    together, before, end = in_pieces(intake, arrays(rows), [])
    apart, before_too, end_too = in_pieces(intake, arrays(rows), cuts)
    one_by_one, _, _ = in_pieces(intake, arrays(rows), range(1, len(rows)))
    same(together, apart)
    same(together, one_by_one)
    assert before.counts == before_too.counts and end.counts == end_too.counts == together.counts
    assert before.counts.received == before.counts.accounted + len(before.waiting.t)


@settings(max_examples=100, deadline=None)
@given(INTAKES, ROWS, ROWS)
def test_a_state_that_was_packed_goes_on_as_if_nothing_had_happened(intake, rows, more):
    state, _ = intake.take(intake.init(), *arrays(rows))
    packed = state.pack()
    assert all(isinstance(v, int | float | np.ndarray) for v in packed.values())
    again = IntakeState.unpack(packed)
    there, _, end = in_pieces(intake, arrays(more), [], state=again)
    here, _, other = in_pieces(intake, arrays(more), [], state=state)
    same(here, there)
    assert end.pack().keys() == other.pack().keys()
    for name, value in end.pack().items():
        assert np.array_equal(value, other.pack()[name], equal_nan=not name.startswith("counts")), name


@settings(max_examples=100, deadline=None)
@given(INTAKES, ROWS)
def test_taking_rows_in_changes_neither_the_state_nor_the_rows(intake, rows):
    t, u, y = (a.copy() for a in arrays(rows))
    for a in (t, u, y):
        a.setflags(write=False)
    state, _ = intake.take(intake.init(), t, u, y)
    before = state.pack()
    intake.take(state, t, u, y)
    intake.flush(state)
    for name, value in state.pack().items():
        assert np.array_equal(value, before[name], equal_nan=not name.startswith("counts")), name


# ---------------------------------------------------------------- a hundred thousand mutated rows


def recording(rows, rng):
    """Rows of a healthy recorder: t, u, y with noise in steps of 0.05."""
    t = 0.25 * np.arange(rows)
    u = rng.uniform(0.1, 0.9, (rows, 1))
    level = 0.5 + 0.3 * np.sin(t[:, None] / 7) + 0.1 * rng.standard_normal((rows, 1))
    flow = np.round((3 + 0.25 * rng.standard_normal((rows, 1))) / 0.05) * 0.05
    return t, u, np.hstack([level, flow])


def mutated(rows, rng):
    """The same with every damage: swaps, repeats, lost and late rows, bad times, absurd values, stuck channels."""
    t, u, y = recording(rows, rng)
    arrives = np.arange(rows) + rng.choice(
        [0, 0, 0, 0, 0, 1.5, 4.5, 30.5], rows
    )  # most in order, some late, some by far
    order = np.repeat(np.argsort(arrives), rng.choice([0, 1, 1, 1, 1, 1, 1, 1, 1, 2], rows))  # some lost, some twice
    t, u, y = t[order], u[order], y[order]
    n = len(t)
    for values in (u, y):
        hit = rng.random(values.shape) < 0.02
        values[hit] = rng.choice([NAN, NAN, NAN, INF, -INF, 1e308, -1e308, 2.0, 1.0, 0.0, -1.0], hit.sum())
    for start in rng.integers(0, n, n // 500):
        j, length = rng.integers(0, 2), rng.integers(2, 90)
        y[start : start + length, j] = y[start, j]
    again = rng.random(n) < 0.02
    again[0] = False
    t[again] = t[np.flatnonzero(again) - 1]
    bad = rng.random(n) < 0.004
    t[bad] = rng.choice([NAN, INF, -INF, 1e15, -1e300, 0.0], bad.sum())
    return t, u, y


# The plain rules look through all that waits for every row, so the case in which everything waits is short.
@pytest.mark.parametrize(
    ("size", "reorder", "leap"), [(100_500, 0.0, 100.0), (100_500, 2.5, 100.0), (3_000, INF, INF)], ids=str
)
def test_a_hundred_thousand_mutated_rows_are_all_accounted_for(size, reorder, leap):
    rng = np.random.default_rng(11)
    rows = mutated(size, rng)
    assert len(rows[0]) >= min(size, 100_000)
    y = (Watch("level", -1.0, 2.0, sd=0.1, hold=0.25), Watch("flow", sd=0.25, hold=0.25))
    intake = Intake(0.25, U, y, reorder, leap)
    taken = intake.whole(*rows)
    agrees_with_the_plain_rules(intake, rows, taken)
    adds_up(taken)
    cuts = [*rng.integers(0, len(rows[0]), 60), 0, 0, 1, 2, 3, len(rows[0])]  # empty pieces and single rows among them
    apart, before, _ = in_pieces(intake, rows, cuts)
    same(taken, apart)
    assert before.counts.received == before.counts.accounted + len(before.waiting.t)
    c = taken.counts
    met = {name: getattr(c, name) for name in ("duplicates", "bad_time", "gaps")}
    met |= {"late": c.late} if reorder < INF else {}
    met |= {"merged": c.merged, "reordered": c.reordered} if reorder else {}
    met |= {name: sum(getattr(c, name)) for name in PER_CHANNEL}
    assert all(met.values()) or size < 100_000, met  # every kind of damage was met
    if leap < INF:
        assert c.passed > 0.6 * c.received  # and one absurd time does not cost the rest of the recording


def test_a_healthy_recording_passes_untouched():
    t, u, y = recording(20_000, np.random.default_rng(5))
    intake = Intake(0.25, U, (Watch("level", -1.0, 2.0, sd=0.1, hold=0.25), Watch("flow", sd=0.25, hold=0.25)))
    taken = intake.whole(t, u, y)
    for came_out, came in ((taken.t, t), (taken.u, u), (taken.y, y)):
        assert np.shares_memory(came_out, came) and np.array_equal(came_out, came)
    assert not (taken.flags_u.any() or taken.flags_y.any() or taken.lacking.any())
    assert taken.counts == replace(Counts.none(3), received=20_000, passed=20_000)
    assert intake.findings(taken.counts) == ()
