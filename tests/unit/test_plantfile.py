# SPDX-License-Identifier: BSD-3-Clause
import re
import tomllib

import numpy as np
import pytest

from faultrecon.finding import InputError
from faultrecon.graph.function import Graph
from faultrecon.io.document import LARGEST
from faultrecon.io.plantfile import parse_plant, read_plant
from faultrecon.io.plantwrite import plant_text, write_plant
from faultrecon.io.positions import line_of, positions, spelled
from faultrecon.plant.lipschitz import Lipschitz
from faultrecon.plant.plant import OperatingPoint, Plant
from faultrecon.plant.signals import Channels, Signals

ROBOT = """\
schema = 1
name   = "flexible-joint robot arm"
[signals]
x = ["theta_m [rad]", "omega_m [rad/s]", "theta_l [rad]", "omega_l [rad/s]"]
u = ["voltage [V]"]
y = [
  "enc_motor [rad]",
  "tacho [rad/s]",   # after a comment
  "enc_link [rad]",
]
[signals.range]
theta_m = 2.0
tacho = 5.0
[noise]
hold = 0.01
sd   = { enc_motor = 1e-3, tacho = 1e-2, enc_link = 1e-3 }
[operating_point]
x = { theta_m = 0.25 }
[matrices]
A = [
  [0, 1, 0, 0],
  [-48.6, -1.25, 48.6, 0],
  [0, 0, 0, 1],
  [19.5, 0, -19.5, 0],
]
B = [[0], [21.6], [0], [0]]
C = { select = ["theta_m", "omega_m", "theta_l"] }
[nonlinearity]
into = ["omega_l"]
phi  = ["-gravity * sin(theta_l)"]
constants = { gravity = 3.33 }
domain    = { theta_l = [-3.2, 3.2] }
lipschitz = "derive"
[known]
into = [{ omega_m = 1.0, omega_l = -0.5 }]
g    = ["0.1 * voltage * cos(enc_motor)"]
[[disturbance]]
name = "load torque"
into = { omega_l = 1.0 }
[[disturbance]]
name = "hum"
on   = { tacho = 0.1 }
role = "noise"
size = 0.5
[[fault]]
name = "tacho drift"
sensor = "tacho"
rate = 2.0
[[fault]]
name = "amplifier"
actuator = "voltage"
effect = "multiplicative"
size = 0.2
"""


def refused(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_plant(text, "robot.toml")
    return str(caught.value)


def changed(old: str, new: str) -> str:
    assert old in ROBOT
    return ROBOT.replace(old, new, 1)


# ---------------------------------------------------------------- what a good file means


def test_every_table_of_a_file_arrives_in_the_plant():
    plant = parse_plant(ROBOT, "robot.toml")
    assert (plant.n, plant.p, plant.signals.u.names) == (4, 3, ("voltage",))
    assert plant.signals.x.units == ("rad", "rad/s", "rad", "rad/s")
    assert plant.signals.x.ranges[0] == 2.0 and plant.signals.y.ranges[1] == 5.0
    assert plant.noise is not None and plant.noise.sd == (1e-3, 1e-2, 1e-3)
    assert plant.point.x == (0.25, 0.0, 0.0, 0.0) and plant.point.y == (0.0, 0.0, 0.0)
    assert np.array_equal(plant.C, np.eye(4)[:3]) and np.array_equal(plant.D, np.zeros((3, 1)))
    assert [(f.name, f.site, f.effect, f.size, f.rate) for f in plant.faults] == [
        ("tacho drift", "sensor", "additive", 1.0, 2.0),
        ("amplifier", "actuator", "multiplicative", 0.2, float("inf")),
    ]
    assert [(d.name, d.role, d.size) for d in plant.disturbances] == [
        ("load torque", "attenuate", 1.0),
        ("hum", "noise", 0.5),
    ]
    assert plant.known is not None and np.array_equal(plant.known.into[:, 0], [0.0, 1.0, 0.0, -0.5])
    assert plant.known.g([0.0, 9.0, 9.0], [2.0], [0.0])[0] == 0.2


def test_a_derived_constant_is_proved_and_lies_above_the_true_one():
    term = parse_plant(ROBOT).nonlinearity
    assert term is not None and term.basis == "proved" and term.reads == ("theta_l",)
    # The steepest slope of 3.33 sin is 3.33 at zero; the bound is asked to be within 1 %.
    assert 3.33 <= term.constant <= 3.33 * 1.01


def test_a_number_for_the_constant_is_only_assumed():
    term = parse_plant(changed('"derive"', "4")).nonlinearity
    assert term is not None and (term.constant, term.basis) == (4.0, "assumed")


def test_a_constant_that_leans_on_the_range_of_an_input_is_not_called_proved():
    text = changed('phi  = ["-gravity * sin(theta_l)"]', 'phi  = ["voltage * sin(theta_l)"]')
    assert "phi reads voltage, which the domain does not bound" in refused(text)
    bounded = text.replace("{ theta_l = [-3.2, 3.2] }", "{ theta_l = [-3.2, 3.2], voltage = [-2, 2] }")
    term = parse_plant(bounded).nonlinearity
    assert term is not None and term.basis == "assumed" and 2.0 <= term.constant <= 2.02
    assert "nonlinearity.domain.voltage: 'voltage' is no state" in refused(bounded.replace('"derive"', "2.0"))


def test_a_term_that_reads_no_state_has_the_constant_zero():
    text = changed('phi  = ["-gravity * sin(theta_l)"]', 'phi  = ["gravity * sin(voltage)"]')
    plant = parse_plant(text.replace("domain    = { theta_l = [-3.2, 3.2] }\n", ""))
    assert plant.nonlinearity is not None
    assert (plant.nonlinearity.constant, plant.nonlinearity.basis) == (0.0, "proved")
    assert parse_plant(plant_text(plant)).digest() == plant.digest()


def test_a_domain_must_bound_every_state_read_for_a_proof():
    message = refused(changed("domain    = { theta_l = [-3.2, 3.2] }\n", ""))
    assert message.startswith("robot.toml:32  nonlinearity.lipschitz: cannot be derived: phi reads theta_l")
    assert "add theta_l = [low, high] to nonlinearity.domain" in message


def test_a_range_can_be_given_by_group_where_a_state_and_a_sensor_share_a_name():
    text = 'schema = 1\nname = "p"\n[signals]\nx = ["h"]\ny = ["h"]\nrange = { x = { h = 2.0 }, y = { h = 3.0 } }\n'
    plant = parse_plant(text + "[matrices]\nA = [[-1]]\nC = [[1]]\n")
    assert (plant.signals.x.ranges, plant.signals.y.ranges) == ((2.0,), (3.0,))
    assert parse_plant(plant_text(plant)).digest() == plant.digest()


def test_a_fault_may_reach_several_sensors_with_signs():
    plant = parse_plant(changed('sensor = "tacho"', "on = { tacho = 1.0, enc_link = -0.5 }"))
    assert np.array_equal(plant.F_f[:, 0], [0.0, 1.0, -0.5])
    plant = parse_plant(changed('actuator = "voltage"', "on = { voltage = 2.0 }"))
    assert plant.faults[1].site == "actuator"
    assert "mixes sensors and inputs" in refused(changed('sensor = "tacho"', "on = { tacho = 1.0, voltage = 1.0 }"))


def test_windows_line_ends_and_a_byte_order_mark_are_read(tmp_path):
    file = tmp_path / "robot.toml"
    file.write_bytes(b"\xef\xbb\xbf" + ROBOT.replace("\n", "\r\n").encode())
    assert read_plant(file).digest() == parse_plant(ROBOT).digest()
    file.write_bytes(ROBOT.replace("[21.6]", "[nan]").replace("\n", "\r\n").encode())
    with pytest.raises(InputError, match=re.escape("robot.toml:26  matrices.B[1][0]: is nan")):
        read_plant(file)


# ---------------------------------------------------------------- what is wrong is named with its place

BAD = [
    # shapes
    ("  [0, 0, 0, 1],\n", "", "robot.toml:20  matrices.A: has 3 rows: signals.x declares 4 states; give 4 rows"),
    ("[0, 0, 0, 1],", "[0, 0, 1],", "robot.toml:23  matrices.A[2]: has 3 entries: signals.x declares 4 states"),
    ("[[0], [21.6], [0], [0]]", "[[0], [21.6], [0]]", "robot.toml:26  matrices.B: has 3 rows"),
    ("[[0], [21.6], [0], [0]]", "[0, 21.6, 0, 0]", "robot.toml:26  matrices.B[0]: is a number, not a list; put it in"),
    (', "theta_l"] }', "] }", "robot.toml:27  matrices.C: selects 2 states for 3 sensors: 'enc_link' has none"),
    ("B = [[0], [21.6], [0], [0]]\n", "", "robot.toml:19  matrices: the key 'B' is missing"),
    # entries
    ("-1.25", "nan", "robot.toml:22  matrices.A[1][1]: is nan; give a finite number"),
    ("21.6", "-inf", "robot.toml:26  matrices.B[1][0]: is -inf; give a finite number"),
    ("21.6", "1" + "0" * 400, "robot.toml:26  matrices.B[1][0]: is a number too large for a double"),
    ("21.6", "'a'", "robot.toml:26  matrices.B[1][0]: is text, not a number: the value is 'a'"),
    ("21.6", "true", "robot.toml:26  matrices.B[1][0]: is a truth value, not a number"),
    ("21.6", "2020-01-01", "robot.toml:26  matrices.B[1][0]: is a date or time, not a number"),
    # names
    ('"theta_m", "omega_m"', '"theta_m", "omega_n"', "matrices.C.select[1]: there is no state 'omega_n'; did you mean"),
    ('"tacho [rad/s]"', '"ta cho [rad/s]"', "robot.toml:8  signals.y[1]: 'ta cho' is no signal name; use letters"),
    ('"tacho [rad/s]"', '"tacho [rad"', "robot.toml:8  signals.y[1]: 'tacho [rad' is no signal; write 'name [unit]'"),
    ('"tacho [rad/s]"', '"enc_motor"', "robot.toml:8  signals.y[1]: 'enc_motor' is declared twice"),
    ('"tacho [rad/s]"', '"time"', "robot.toml:8  signals.y[1]: 'time' names the time; rename the signal"),
    ('"voltage [V]"', '"tacho [V]"', "robot.toml:5  signals.u[0]: 'tacho' is both an input and a sensor"),
    (
        "tacho = 5.0",
        "taco = 5.0",
        "robot.toml:13  signals.range.taco: there is no signal 'taco'; did you mean 'tacho'",
    ),
    ("tacho = 5.0", "tacho = -5.0", "robot.toml:13  signals.range.tacho: is -5.0; give a positive number"),
    ("{ theta_m = 0.25 }", "{ thet_m = 0.25 }", "robot.toml:18  operating_point.x.thet_m: there is no state 'thet_m'"),
    (
        'sensor = "tacho"',
        'sensor = "tachi"',
        "robot.toml:47  fault[0].sensor: there is no sensor 'tachi'; did you",
    ),
    ('actuator = "voltage"', 'sensor = "voltage"', "robot.toml:51  fault[1].sensor: there is no sensor 'voltage'"),
    ("{ tacho = 0.1 }", "{ tchao = 0.1 }", "robot.toml:42  disturbance[1].on.tchao: there is no sensor 'tchao'"),
    ('name = "amplifier"', 'name = "hum"', "disturbance[1].name: 'hum' names two faults or disturbances"),
    ('name = "amplifier"', 'name = ""', "robot.toml:50  fault[1].name: is empty; give the channel a name"),
    # keys
    ("[noise]", "[nose]", "robot.toml:14  nose: unknown key 'nose'; did you mean 'noise'?"),
    ("hold = 0.01", "hlod = 0.01", "robot.toml:15  noise.hlod: unknown key 'hlod'; did you mean 'hold'?"),
    (
        'lipschitz = "derive"',
        'lipshitz = "derive"',
        "robot.toml:33  nonlinearity.lipshitz: unknown key 'lipshitz';",
    ),
    ('role = "noise"', 'role = "nosie"', "disturbance[1].role: 'nosie' is none of attenuate, decouple, noise; did you"),
    ("rate = 2.0", "rat = 2.0", "robot.toml:48  fault[0].rat: unknown key 'rat'; did you mean 'rate'?"),
    ('sensor = "tacho"\n', "", "robot.toml:45  fault[0]: sits nowhere; give one of sensor"),
    ('[[fault]]\nname = "amp', '[fault.x]\nname = "amp', "robot.toml:49  fault[0].x: unknown key 'x'"),
    # values
    ("hold = 0.01", "hold = 0", "robot.toml:15  noise.hold: is 0.0; give a positive number"),
    (", enc_link = 1e-3 }", " }", "robot.toml:16  noise.sd: gives no level for 'enc_link'; add enc_link = 0.0"),
    ("tacho = 1e-2", "tacho = -1e-2", "robot.toml:16  noise.sd.tacho: is -0.01: a standard deviation is not negative"),
    ("rate = 2.0", "rate = nan", "robot.toml:48  fault[0].rate: is nan"),
    ("size = 0.5", "size = 0", "disturbance[1].size: is 0.0; give a positive number"),
    ("[-3.2, 3.2]", "[3.2, -3.2]", "robot.toml:32  nonlinearity.domain.theta_l: is [3.2, -3.2]: it is empty"),
    ("[-3.2, 3.2]", "[-3.2]", "robot.toml:32  nonlinearity.domain.theta_l: has 1 ends; write theta_l = [low, high]"),
    ("[-3.2, 3.2]", "[-inf, 3.2]", "robot.toml:33  nonlinearity.lipschitz: cannot be derived: phi reads theta_l"),
    ('"derive"', '"drive"', "robot.toml:33  nonlinearity.lipschitz: is 'drive'; give a number, or"),
    ('"derive"', "-1", "robot.toml:33  nonlinearity.lipschitz: is -1.0; a Lipschitz constant is not negative"),
    ("schema = 1", "schema = 2", "robot.toml:1  schema: is 2: this release reads schema 1; use a newer release"),
    ("schema = 1", "schema = '1'", "robot.toml:1  schema: is '1': a schema is a whole number; write: schema = 1"),
    ("schema = 1\n", "", "robot.toml:1  the file: the key 'schema' is missing; begin the file with: schema = 1"),
    ("schema = 1", "shcema = 1", "the key 'schema' is missing; did you mean 'shcema'?, or begin the file"),
    # formulas
    ("sin(theta_l)", "sine(theta_l)", "robot.toml:30  nonlinearity.phi[0]: unknown function 'sine' in"),
    ("sin(theta_l)", "__import__('os')", "robot.toml:30  nonlinearity.phi[0]: unknown function '__import__' in"),
    ("sin(theta_l)", "theta_l.real", "robot.toml:30  nonlinearity.phi[0]: an attribute (a.b) is not allowed"),
    ("cos(enc_motor)", "cos(enc_moter)", "known.g[0]: unknown name 'enc_moter' in '0.1 * voltage * cos(enc_moter)'"),
    (
        "gravity = 3.33",
        "theta_l = 3.33",
        "robot.toml:31  nonlinearity.constants.theta_l: 'theta_l' is a signal",
    ),
    ("gravity = 3.33", "gravity = nan", "robot.toml:31  nonlinearity.constants.gravity: is nan; give a finite number"),
    ("gravity = 3.33", '"g r" = 3.33', "robot.toml:31  nonlinearity.constants.'g r': 'g r' is no name; use letters"),
    (
        'into = ["omega_l"]',
        'into = ["omega_l", "omega_m"]',
        "nonlinearity.into: has 2 entries for 1 formulas",
    ),
    (
        'into = ["omega_l"]',
        'into = ["omega_l"]\nreads = ["theta_m"]',
        "uses the state 'theta_l': nonlinearity.reads",
    ),
    (
        'into = ["omega_l"]',
        'into = ["omega_l"]\nreads = ["a"]',
        "nonlinearity.reads[0]: there is no state 'a'",
    ),
    ("sin(theta_l)", "log(theta_l)", "robot.toml:33  nonlinearity.lipschitz: no Lipschitz constant in 'x'"),
    # TOML itself
    ("hold = 0.01", "hold = ", "robot.toml:15  is not valid TOML: Invalid value"),
    ("hold = 0.01", "hold = 0.01\nhold = 0.02", "robot.toml:16  is not valid TOML: Cannot overwrite a value"),
    ("hold = 0.01", "hold = " + "[" * 5000, "is nested too deeply to be a plant"),
    ("hold = 0.01", "hold = " + "9" * 5000, "robot.toml:"),
    ('effect = "multiplicative"\nsize = 0.2\n', 'effect = """', "robot.toml:52  is not valid TOML"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=range(len(BAD)))
def test_a_wrong_file_is_refused_with_file_line_key_and_remedy(old, new, message):
    assert message in refused(changed(old, new))


def test_a_forbidden_name_in_a_formula_names_file_place_value_and_remedy():
    message = refused(changed("sin(theta_l)", "sin(theta_ll)"))
    assert message.startswith("robot.toml:30  nonlinearity.phi[0]: unknown name 'theta_ll'")
    assert "column 16" in message and "did you mean 'theta_l'?" in message


def test_a_second_formula_on_another_line_is_blamed_on_its_own_line():
    text = changed('phi  = ["-gravity * sin(theta_l)"]', 'phi  = ["theta_l",\n  "cost(theta_l)"]')
    assert "robot.toml:31  nonlinearity.phi[1]: unknown function 'cost'" in refused(
        text.replace('into = ["omega_l"]', 'into = ["omega_l", "omega_m"]')
    )


def test_one_fault_table_in_single_brackets_is_explained():
    head = ROBOT[: ROBOT.index("[[fault]]")]
    assert "fault: is one table, not a list of them; write [[fault]]" in refused(head + '[fault]\nname = "f"\n')


# ---------------------------------------------------------------- files that are no plant files


def test_files_that_cannot_be_read_are_refused_by_name(tmp_path):
    missing = tmp_path / "robt.toml"
    (tmp_path / "robot.toml").write_text(ROBOT)
    with pytest.raises(InputError, match=r"robt\.toml: no such file; did you mean 'robot\.toml'\?"):
        read_plant(missing)
    with pytest.raises(InputError, match="nowhere does not exist"):
        read_plant(tmp_path / "nowhere" / "robot.toml")
    with pytest.raises(InputError, match="is a folder, not a file; name a file in it"):
        read_plant(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_plant("a\0b.toml")


def test_a_file_that_is_not_utf8_is_refused_with_line_and_byte(tmp_path):
    file = tmp_path / "latin.toml"
    file.write_bytes('schema = 1\nname = "Höhe"\n'.encode("latin-1"))
    with pytest.raises(InputError, match=r"latin\.toml:2  byte 20 is 0xf6, which is not UTF-8; save the file as UTF-8"):
        read_plant(file)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    file = tmp_path / "huge.toml"
    with file.open("wb") as opened:
        opened.truncate(LARGEST + 1)
    with pytest.raises(InputError, match=f"has {LARGEST + 1} bytes: a plant file has {LARGEST} at most"):
        read_plant(file)


# ---------------------------------------------------------------- writing


def test_a_written_plant_reads_back_the_same_to_the_last_bit(tmp_path):
    plant = parse_plant(ROBOT)
    write_plant(plant, tmp_path / "robot.toml")
    again = read_plant(tmp_path / "robot.toml")
    assert again.digest() == plant.digest()
    assert again.nonlinearity is not None and again.nonlinearity.basis == "proved"


def test_a_written_matrix_has_one_row_per_line():
    lines = plant_text(parse_plant(ROBOT)).splitlines()
    assert lines[lines.index("A = [") + 2] == "  [-48.6, -1.25, 48.6, 0.0],"


def _with_phi(term: Lipschitz) -> Plant:
    signals = Signals(Channels(("a", "b")), Channels(()), Channels(("y",)))
    return Plant("p", signals, np.eye(2), np.zeros((2, 0)), np.ones((1, 2)), np.zeros((1, 0)), nonlinearity=term)


def test_a_traced_nonlinearity_has_no_formula_to_write():
    plant = parse_plant(ROBOT).reading_all_states()
    with pytest.raises(InputError, match=r"phi was not built from formulas.*Graph\.from_texts"):
        plant_text(plant)


def test_a_proof_that_a_file_cannot_repeat_is_not_written():
    phi = Graph.from_texts(["sin(a)"], {"x": ("a",), "u": (), "t": ("t",)})
    claimed = Lipschitz(np.array([[1.0], [0.0]]), ("a",), phi, 0.5, "proved", {"a": (-1.0, 1.0)})
    with pytest.raises(InputError, match=r"the proved Lipschitz constant 0\.5 cannot be written"):
        plant_text(_with_phi(claimed))


def test_a_graph_of_other_inputs_is_not_written():
    phi = Graph.from_texts(["sin(a)"], {"x": ("a",), "t": ("t",)})
    with pytest.raises(InputError, match="phi is a function of"):
        plant_text(_with_phi(Lipschitz(np.array([[1.0], [0.0]]), ("a",), phi, 1.0)))


def test_minus_zero_and_odd_names_survive():
    text = changed('name = "load torque"', 'name = "Last\\"moment\\" \\\\ \\u00e9"')
    plant = parse_plant(text.replace("19.5, 0,", "19.5, -0.0,").replace("theta_m = 0.25", "theta_m = -0.0"))
    again = parse_plant(plant_text(plant))
    assert again.digest() == plant.digest()
    assert again.disturbances[0].name == 'Last"moment" \\ é'
    assert np.signbit(again.point.x[0]) and np.signbit(again.A[3, 1])
    assert isinstance(again.operating_point, OperatingPoint)


# ---------------------------------------------------------------- lines

TRICKY = '''\
# a = 1
"quoted key" = 'it''s'
text = """ [not.a.table]
# not a comment ] } \\""" still
""""
raw = \'\'\'
x = 1\'\'\'\'
a.b . "c.d" = [ 1, [2, # two ]
  3], { k = [
  "]", 4 ], l.m = 5 } ,
]
[ t . s ]
[[t.list]]
v = 1
[t.list.sub]
w = 2
[[t.list]]
[[t.list.deep]]
v = "#"
[[t.list.deep]]
v = 1979-05-27T07:32:00Z
z = +1_000.5e-3
'''.replace("'it''s'", "'its'")

LINES = {
    "'quoted key'": 2,
    "text": 3,
    "raw": 6,
    "a.b.'c.d'": 8,
    "a.b.'c.d'[1][0]": 8,
    "a.b.'c.d'[1][1]": 9,
    "a.b.'c.d'[2].k[0]": 10,
    "a.b.'c.d'[2].l.m": 10,
    "t.s": 12,
    "t.list[0]": 13,
    "t.list[0].v": 14,
    "t.list[0].sub.w": 16,
    "t.list[1]": 17,
    "t.list[1].deep[0].v": 19,
    "t.list[1].deep[1].v": 21,
    "t.list[1].deep[1].z": 22,
}


def test_the_line_of_every_value_is_found_in_a_tricky_file():
    tomllib.loads(TRICKY)
    found = {spelled(path): line for path, line in positions(TRICKY).items()}
    assert {key: found.get(key) for key in LINES} == LINES


def test_a_place_the_scanner_does_not_know_falls_back_to_what_is_around_it():
    lines = positions("[a]\nb = 1\n")
    assert line_of(("a", "zz", 3), lines) == 1 and line_of(("nowhere",), lines) == 1
    assert positions("a = [1, 2") == {("a",): 1, ("a", 0): 1, ("a", 1): 1}
