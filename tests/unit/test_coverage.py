# SPDX-License-Identifier: BSD-3-Clause
"""How much of a log a certificate over a box speaks about."""

import json
from dataclasses import replace

import numpy as np
import pytest

import faultrecon as fr
from faultrecon.advise.activated_sludge import reactor, recording
from faultrecon.io.plausibility import doubts
from faultrecon.io.playback import replay
from faultrecon.plant.sector import Sector


@pytest.fixture(scope="module")
def low():
    """The tank whose ammonium falls below the box."""
    plant = reactor("last_tank")
    return replay(fr.design(plant, "ts-guaranteed-cost"), recording("last_tank", plant))


def test_samples_in_which_the_estimate_left_the_box_are_counted_and_told(low):
    found, box = low.coverage(), low.design.plant.polytopic.boxes
    x, u, f = low.trace.state, low.log.u, low.trace.fault[:, 0]
    assert found is not None
    least, most = np.array([*box["x"], *box["u"]]).T
    signals = np.hstack([x, u])
    outside = ((signals < least) | (signals > most)).any(axis=1) | (f < -0.5) | (f > 0.05)
    # Every premise is proved to stay between its bounds over the box, so nothing else is left.
    assert found.outside == np.count_nonzero(outside) > 100
    assert found.left["substrate"][0] == np.count_nonzero((x[:, 1] < least[1]) | (x[:, 1] > most[1]))
    (note,) = [text for text in doubts(low) if "certificate" in text]
    assert f"does not cover {found.outside} of {len(low.log)} samples" in note and "substrate not in [1, 12.8]" in note
    assert json.dumps(found.as_dict())


def test_the_margin_is_that_of_the_nearest_premise(low):
    found = low.coverage()
    margin = Sector.of(low.design.plant).membership_margin(low.trace.state, low.log.u)
    assert np.array_equal(found.margin, margin)
    assert not found.covered[margin < 0].any()


def test_nothing_is_noted_while_the_estimate_stays_in_the_box(low):
    log = low.log
    rest = low.design.plant.point
    quiet = replace(log, u=np.tile(rest.u, (len(log), 1)), y=np.tile(rest.y, (len(log), 1)))
    done = replay(low.design, quiet)
    assert done.coverage().outside == 0 and "all 4029 samples" in str(done.coverage())
    assert not [text for text in doubts(done) if "certificate" in text]


def test_an_estimate_that_is_not_known_is_not_covered(low):
    y = low.log.y.copy()
    trace = replace(low.trace, state=np.full_like(low.trace.state, np.nan))
    assert replace(low, trace=trace, log=replace(low.log, y=y)).coverage().outside == len(y)


def test_the_published_theorem_asks_for_its_premises_and_faults_alone():
    plant = reactor("last_tank")
    done = replay(fr.design(plant, "ts-published"), recording("last_tank", plant))
    names = {*Sector.of(plant).family.names, "fouling"}
    assert done.coverage().left.keys() <= names


def test_a_design_whose_certificate_knows_no_box_has_nothing_to_watch(low):
    plant = low.design.plant
    done = replay(fr.design(plant, "simulate-invert", certify=False), low.log)
    assert done.coverage() is None
    assert not [text for text in doubts(done) if "certificate" in text]
