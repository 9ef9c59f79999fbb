# SPDX-License-Identifier: BSD-3-Clause
"""A method is one file, also when it belongs to somebody else: packages are built here and tried by a process."""

import json
import os
import subprocess
import sys
import textwrap

import pytest

from faultrecon.io.template import TEMPLATE

# A paper of our own making: the theorem of lipschitz-hinf with a further inequality, P > ε I.
METHOD = """
from faultrecon.lmi.expr import I
from faultrecon.methods.base import Paper
from faultrecon.methods.lipschitz_hinf import LipschitzHinf


class Steady(LipschitzHinf):
    name = "steady"
    summary = "lipschitz-hinf with a Lyapunov matrix bounded from below"
    paper = Paper("doe2030", "Doe, J.", 2030, "Steady reconstruction", "Journal of Examples 1", "10.0/steady")
    reproductions = ()

    def also(self, P, α, n):
        return [(P - 1e-9 * I(n) > 0).tagged("P > ε I")]
"""

EVERYTHING = """
import json, pathlib, sys
import faultrecon as fr
from faultrecon.io.plantfile import parse_plant

plant = parse_plant(pathlib.Path("plant.toml").read_text(encoding="utf-8"))
made = fr.design(plant, "steady")
fr.save(made, "design.json")
print(json.dumps({
    "names": fr.list_methods(),
    "cite": fr.cite("steady"),
    "method": made.method,
    "verdict": fr.verify("design.json").verdict,
    "again": fr.load("design.json", plant=plant).level == made.level,
    "steps": [s.label for s in made.certificate.verify().steps],
}))
"""


@pytest.fixture
def world(tmp_path):
    """A folder to work in with a plant file."""
    (tmp_path / "plant.toml").write_text(TEMPLATE, encoding="utf-8")
    return tmp_path


def publish(folder, package, source, points):
    """Install a package the way an installer leaves it: a module, and metadata with its entry points."""
    site = folder / "site"
    site.mkdir(exist_ok=True)
    (site / f"{package}.py").write_text("# SPDX-License-Identifier: MIT\n" + textwrap.dedent(source), encoding="utf-8")
    info = site / f"{package}-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n", encoding="utf-8")
    lines = [f"{name} = {package}:{target}" for name, target in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[faultrecon.methods]", *lines]) + "\n", encoding="utf-8")


def run(folder, *arguments, installed=True):
    """One process that sees the published packages, or does not."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"}
    environment["PYTHONPATH"] = str(folder / "site") if installed else ""
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, check=False, cwd=folder, env=environment, capture_output=True, text=True, encoding="utf-8"
    )


def test_a_third_partys_method_is_listed_designed_proved_cited_and_read_back(world):
    publish(world, "doe_methods", METHOD, {"steady": "Steady"})
    done = run(world, "-W", "error", "-c", EVERYTHING)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert "steady" in found["names"] and found["names"].index("steady") > found["names"].index("lipschitz-hinf")
    assert found["cite"] == "Doe, J. (2030). Steady reconstruction. Journal of Examples 1. doi:10.0/steady"
    assert (found["method"], found["verdict"], found["again"]) == ("steady", "proved", True)
    assert "P > ε I" in found["steps"]  # its own inequality is in the certificate, and was proved


def test_the_command_line_lists_designs_and_cites_it(world):
    publish(world, "doe_methods", METHOD, {"steady": "Steady"})
    listed = run(world, "-m", "faultrecon", "methods", "--json")
    rows = {row["name"]: row for row in json.loads(listed.stdout)["methods"]}
    assert rows["steady"]["paper"] == "doe2030" and rows["steady"]["summary"].startswith("lipschitz-hinf with")
    cited = run(world, "-m", "faultrecon", "cite", "steady")
    assert cited.stdout.startswith("Doe, J. (2030).")
    made = run(world, "-m", "faultrecon", "design", "plant.toml", "-m", "steady", "--out", "design.json")
    assert made.returncode == 0, made.stderr
    assert run(world, "-m", "faultrecon", "verify", "design.json").returncode == 0
    # The certificate holds all it needs and is checked where nobody knows the method; running it asks for the package.
    assert run(world, "-m", "faultrecon", "verify", "design.json", installed=False).returncode == 0
    unknown = run(world, "-c", "import faultrecon as fr; fr.load('design.json')", installed=False)
    assert "there is no method 'steady'" in unknown.stderr


BROKEN = {
    "import error": ("import a_module_nobody_has\n", "X", ["cannot be imported", "a_module_nobody_has"]),
    "missing class": ("", "Absent", ["cannot be imported", "Absent"]),
    "no Method": ("class X:\n    pass\n", "X", ["is no Method", "class"]),
    "not a class": ("X = 3\n", "X", ["is no Method", "it is 3"]),
    "abstract": (
        "from faultrecon.methods.base import Method\n\n\nclass X(Method):\n    name = 'half'\n",
        "X",
        ["is not complete", "assumptions, observer, theorem, summary, paper"],
    ),
    "our name": (METHOD.replace('"steady"', '"open-loop"'), "Steady", ["is left out", "faultrecon.methods.open_loop"]),
    "exit": ("raise SystemExit(7)\n", "X", ["cannot be imported", "SystemExit: 7"]),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_package_takes_out_its_own_method_alone_and_says_which_and_why(world, kind):
    source, target, words = BROKEN[kind]
    publish(world, "broken_package", source, {"wonder": target})
    code = """
        import json, warnings
        from faultrecon.methods import registry
        from faultrecon.finding import InputError
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            names = registry.list_methods()
        try:
            registry.method("wonder")
        except InputError as error:
            said = str(error)
        ours = type(registry.method("open-loop")).__module__
        print(json.dumps([names, [str(w.message) for w in heard], said, ours]))
    """
    done = run(world, "-c", textwrap.dedent(code))
    assert done.returncode == 0, done.stderr
    names, heard, said, ours = json.loads(done.stdout)
    assert "lipschitz-hinf" in names and "wonder" not in names and ours == "faultrecon.methods.open_loop"
    assert heard == [said]  # one warning, and the same words when it is asked for
    assert said.startswith(f"the entry point wonder = broken_package:{target} of broken_package 1.2 ")
    assert all(word in said for word in [*words, "uninstall it"])


def test_other_verbs_work_beside_a_broken_package_and_the_broken_one_is_exit_code_2(world):
    publish(world, "broken_package", "import a_module_nobody_has\n", {"wonder": "X"})
    made = run(world, "-m", "faultrecon", "design", "plant.toml", "--out", "design.json", "--json")
    assert made.returncode == 0 and json.loads(made.stdout)["verdict"] == "proved"
    assert "wonder" in made.stderr  # on the error stream, so that JSON stays JSON
    refused = run(world, "-m", "faultrecon", "design", "plant.toml", "-m", "wonder")
    assert refused.returncode == 2 and "a_module_nobody_has" in refused.stderr


def test_of_two_packages_with_one_name_the_first_by_name_stays_and_the_other_is_told(world):
    publish(world, "a_package", METHOD, {"one": "Steady"})
    publish(world, "b_package", METHOD, {"two": "Steady"})
    code = "from faultrecon.methods import registry as r; print(type(r.method('steady')).__module__)"
    done = run(world, "-c", code)
    assert done.stdout.strip() == "a_package"
    assert "two = b_package:Steady" in done.stderr and "two methods are called 'steady'" in done.stderr
