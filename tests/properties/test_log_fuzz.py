# SPDX-License-Identifier: BSD-3-Clause
"""A damaged recording is read or refused by name; nothing else happens, and nothing hangs."""

import time

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.io.logs import orderly, read_log
from faultrecon.plant.signals import Channels, Signals
from faultrecon.runtime.intake import Intake
from faultrecon.runtime.intake_watch import Watch

SIGNALS = Signals(Channels(("x",)), Channels(("voltage",)), Channels(("encoder", "tacho")))
INTAKE = Intake(0.1, (Watch("voltage"),), (Watch("encoder", -4.0, 4.0), Watch("tacho", sd=0.1, hold=0.1)), 0.2, 100.0)
PLAIN = "t,voltage,encoder,tacho,note\n" + "".join(f"{k / 10},{k % 3},{k * 0.11:.3f},{k**2}e-2,ok\n" for k in range(30))
DATES = "time,voltage,encoder,tacho\n" + "".join(f"2026-03-01T12:00:{k:02d}.5Z,1,,{-k}\n" for k in range(30))
QUOTED = '\ufeff"t","voltage","encoder","tacho"\r\n' + "".join(f'"{k}","1"," 2 ","NaN"\r\n' for k in range(30))
# Bytes that mean something in such a file, or to those who read it.
TELLING = [*b"0123456789,,,\n\r\";\t .-+eE:TZ#\\'nNaAifIN/", 0x00, 0x1A, 0x7F, 0xC3, 0xE2, 0xEF, 0xFE, 0xFF]
ODD = [
    b"1e999",
    b"-inf",
    b"nan",
    b"\r\n",
    b'""',
    b'"',
    b"\x00\x00",
    b"PAR1",
    b"1" * 400,
    b"9999-12-31T23:59:59Z",
    b",,,",
]


def damaged(data, rng):
    """The bytes with one to four pieces changed, cut out, put in, doubled or moved, or the end cut off."""
    for _ in range(min(4, rng.geometric(0.6))):
        a = int(rng.integers(0, len(data) + 1))
        b = min(len(data), a + int(rng.choice([1, 1, 1, 2, 5, 40])))
        kind = rng.integers(0, 7)
        if kind <= 1:
            data = data[:a] + bytes(rng.choice(TELLING, b - a).astype(np.uint8)) + data[b:]
        elif kind == 2:
            data = data[:a] + data[b:]
        elif kind == 3:
            data = data[:a] + ODD[rng.integers(0, len(ODD))] + data[a:]
        elif kind == 4:
            data = data[:b] + data[a:]
        elif kind == 5:
            lines = data.split(b"\n")
            i, j = rng.integers(0, len(lines), 2)
            lines[i], lines[j] = lines[j], lines[i]
            data = b"\n".join(lines)
        elif rng.random() < 0.2:
            data = data[:a]
    return data


@pytest.mark.parametrize("as_it_came", [False, True])
@pytest.mark.parametrize("text", [PLAIN, DATES, QUOTED], ids=["plain", "dates", "quoted"])
def test_a_damaged_csv_file_is_a_log_or_a_refusal_that_names_it(tmp_path, text, as_it_came):
    """340 files each, 2040 in all."""
    rng = np.random.default_rng(len(text) + as_it_came)
    file = tmp_path / "damaged.csv"
    read = refused = 0
    for k in range(340):
        file.write_bytes(damaged(text.encode("utf-8"), rng))
        began = time.perf_counter()
        try:
            log = read_log(file, SIGNALS, as_it_came=as_it_came)
        except InputError as error:
            refused += 1
            assert "damaged.csv" in str(error), k
        else:
            read += 1
            rows = len(log)
            assert log.u.shape == (rows, 1) and log.y.shape == (rows, 2)
            if as_it_came:
                ordered, taken = orderly(log, INTAKE)
                assert taken.counts.received == taken.counts.accounted == rows
                log = ordered
            else:
                assert not np.isinf(np.hstack([log.u, log.y])).any()
            assert np.isfinite(log.t).all() and np.all(log.t[1:] > log.t[:-1])
        assert time.perf_counter() - began < 5.0, k  # it takes a millisecond; a hang takes for ever
    assert read > 20 and refused > 20, (read, refused)
