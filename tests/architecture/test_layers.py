# SPDX-License-Identifier: BSD-3-Clause
"""The shape of the package: imports point downwards, files stay short, the door is lean and documented."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import faultrecon

ROOT = Path(faultrecon.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
RELATIVE = [str(f.relative_to(ROOT)) for f in FILES]

LAYERS = (
    ("finding",),
    ("numerics", "storage"),
    ("lmi", "graph"),
    ("plant",),
    ("diagnosis",),
    ("methods",),
    ("certificate", "synthesis"),
    ("runtime",),
    ("simulation",),
    ("codegen", "io", "plot"),
    ("advise", "report"),
    ("cli", "testing"),
    ("__init__", "__main__"),
)
LEVEL = {name: k for k, names in enumerate(LAYERS) for name in names}

DEFERRED = {("synthesis", "runtime"), ("simulation", "plot")}
"""Upward edges that are taken inside a function: Design.estimator forwards to the runtime, Run.plot to the figures."""

LONG_FILES: dict[str, str] = {}
"""Files of 400 lines or more, each with a reason."""

LONG_FUNCTIONS: dict[str, str] = {
    "synthesis/pipeline.py:design": "half is its signature and docstring; the order of the stages is one thought",
    "runtime/watchloop.py:pass_over": "one pass over the samples, compiled as it stands: a call per sample costs",
    "cli/app.py:design": "its signature is the command line",
    "cli/app.py:run": "its signature is the command line",
}
"""Functions of 60 lines or more, each with a reason."""


def part_of(path):
    """The layer's name of a file: its folder, or its own name at the top."""
    relative = Path(path).relative_to(ROOT)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def imports(path):
    """Every import of a file: module, and whether it runs when the file is loaded."""
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    found = []

    def visit(node, at_load):
        for child in ast.iter_child_nodes(node):
            inside = at_load and not isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue  # types alone are no dependency at run time
            if isinstance(child, ast.Import):
                found.extend((alias.name, at_load) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{path}: relative import"
                found.append((child.module, at_load))
                found.extend((f"{child.module}.{a.name}", at_load) for a in child.names if child.module == "faultrecon")
            elif isinstance(child, ast.Call) and ast.unparse(child.func).endswith("import_module"):
                found.extend((a.value, at_load) for a in child.args if isinstance(a, ast.Constant))
            visit(child, inside)

    visit(tree, True)
    return found


GRAPH = {str(f.relative_to(ROOT)): imports(f) for f in FILES}


def own(module):
    """The layer's name of one of our modules, or None."""
    words = module.split(".")
    if words[0] != "faultrecon":
        return None
    return words[1] if len(words) > 1 else "__init__"


def test_every_file_belongs_to_a_layer():
    assert {part_of(f) for f in FILES} <= set(LEVEL)


@pytest.mark.parametrize("path", RELATIVE)
def test_imports_point_downwards(path):
    here = part_of(ROOT / path)
    for module, at_load in GRAPH[path]:
        there = own(module)
        if there is None or there == here or there not in LEVEL:
            continue
        if there == "__init__":
            assert not at_load or here in ("cli", "testing", "__main__"), path
        elif (here, there) != ("synthesis", "certificate") and not ((here, there) in DEFERRED and not at_load):
            assert LEVEL[there] < LEVEL[here], f"{path} imports {module}"


def test_the_list_of_deferred_upward_edges_is_not_longer_than_needed():
    taken = {
        (part_of(ROOT / path), own(module))
        for path, found in GRAPH.items()
        for module, _ in found
        if own(module) in LEVEL and LEVEL[own(module)] > LEVEL[part_of(ROOT / path)] and own(module) != "__init__"
    }
    assert taken == DEFERRED


def third_party(path, at_load_only=False):
    return {
        m.split(".")[0]
        for m, at_load in GRAPH[path]
        if (at_load or not at_load_only) and m.split(".")[0] not in {*sys.stdlib_module_names, "faultrecon"}
    }


def test_numerics_knows_arrays_only():
    for path in RELATIVE:
        if path.startswith("numerics/"):
            assert third_party(path) <= {"numpy", "scipy"}, path
            assert {own(m) for m, _ in GRAPH[path]} - {None} <= {"numerics", "finding"}, path


def test_the_inequality_layer_knows_no_plants():
    for path in RELATIVE:
        if path.startswith("lmi/"):
            assert {own(m) for m, _ in GRAPH[path]} - {None} <= {"lmi", "finding"}, path


def test_the_checker_needs_the_standard_library_alone():
    assert third_party("certificate.py") == set()
    modules = {m for m, _ in GRAPH["certificate.py"] if own(m)}
    assert modules <= {"faultrecon.finding", "faultrecon.lmi.exact", "faultrecon.storage.hashing"}
    for path in ("lmi/exact.py", "storage/hashing.py", "finding.py", "lmi/__init__.py", "storage/__init__.py"):
        assert third_party(path) == set()
        assert not [m for m, _ in GRAPH[path] if own(m)]


SAMPLED = {
    "kalman_filter",
    "kalman_steps",
    "sampled_conditions",
    "sampled_letters",
    "sampled_limits",
    "sampled_mismatch",
    "sampled_plants",
    "sampled_prediction",
}


def test_methods_never_import_each_other():
    machinery = {
        "base",
        "fault_state",
        "papers",
        "registry",
        "regular_form",
        "guaranteed_variance",
        "scaled_conditions",
        "scaled_sensors",
        "sliding_letters",
        "errors_uio",
        "parallel_model",
    } | SAMPLED
    names = {Path(p).stem for p in RELATIVE if p.startswith("methods/")} - machinery - {"__init__"}
    for path in RELATIVE:
        if path.startswith("methods/"):
            others = {m.split(".")[2] for m, _ in GRAPH[path] if m.startswith("faultrecon.methods.")}
            assert not others & (names - {Path(path).stem}), path
            assert not {own(m) for m, _ in GRAPH[path]} & {"io", "cli", "plot", "report", "advise"}, path


@pytest.mark.parametrize(
    ("library", "allowed"),
    [
        ("clarabel", r"lmi/solve\.py"),
        ("matplotlib", r"plot/.*"),
        ("plotly", r"(report|plot)/.*"),
        ("pandas", r"(io|advise|simulation)/.*"),
        ("pyarrow", r"io/.*"),
        ("typer", r"cli/.*"),
        ("flint", r"(lmi/prove|graph/\w+|cli/health)\.py"),
        ("cvxpy", "nowhere"),
    ],
)
def test_a_library_is_imported_in_one_place(library, allowed):
    users = [p for p in RELATIVE if library in third_party(p)]
    assert [p for p in users if not re.fullmatch(allowed, p)] == []


HEAVY = {"casadi", "clarabel", "flint", "numba", "pandas", "pyarrow", "matplotlib", "plotly", "scipy"}


@pytest.mark.parametrize("path", RELATIVE)
def test_heavy_libraries_load_on_first_use(path):
    assert not third_party(path, at_load_only=True) & HEAVY


OPENERS = {"open", "read_text", "write_text", "read_bytes", "write_bytes", "mkstemp", "NamedTemporaryFile", "savefig"}
MAY_OPEN = r"(storage|io)/.*|certificate\.py"
OPEN_ELSEWHERE = {
    "savefig": r"plot/.*",  # matplotlib writes the picture itself, into an atomic file
    "write_text": r"graph/compiled\.py",  # the source that Numba wants beside its cached machine code
}
EXECUTES = {
    "graph/compiled.py": "Numba compiles functions, so the program that this process generated has to be defined"
}


@pytest.mark.parametrize("path", RELATIVE)
def test_only_storage_and_io_open_files(path):
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    froms = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    names = {f"{n.module}.{a.name}" for n in froms for a in n.names}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or "devnull" in ast.unparse(node):
            continue
        called = ast.unparse(node.func).split(".")[-1]
        if called in OPENERS and f"faultrecon.storage.atomic.{called}" not in names:
            allowed = OPEN_ELSEWHERE.get(called, MAY_OPEN)
            assert re.fullmatch(allowed, path) or re.fullmatch(MAY_OPEN, path), f"{path}:{node.lineno} {called}"


@pytest.mark.parametrize("path", RELATIVE)
def test_nothing_is_evaluated_or_unpickled(path):
    calls = [n for n in ast.walk(ast.parse((ROOT / path).read_text("utf-8"))) if isinstance(n, ast.Call)]
    names = {n.func.id for n in calls if isinstance(n.func, ast.Name)}
    assert not names & {"eval", "exec", "compile", "__import__"} or path in EXECUTES
    assert not {m.split(".")[0] for m, _ in GRAPH[path]} & {"pickle", "marshal", "shelve", "dill"}


# ---------------------------------------------------------------- the door


def test_no_submodule_shares_the_name_of_a_public_call():
    modules = {p.split("/")[0].removesuffix(".py") for p in RELATIVE if not p.startswith("__")}
    assert not modules & set(faultrecon.__all__)


@pytest.mark.parametrize("name", faultrecon.__all__)
def test_every_public_name_exists_and_is_documented(name):
    value = getattr(faultrecon, name)
    if name == "__version__":
        assert re.fullmatch(r"\d+\.\d+\.\d+.*", value)
        return
    text = inspect.getdoc(value)
    assert text
    assert not text.startswith(f"{name}(")  # what dataclasses write for want of a docstring


def test_the_door_lists_what_type_checkers_see():
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    typed = {
        alias.name: node.module
        for branch in ast.walk(tree)
        if isinstance(branch, ast.If)
        for node in branch.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert typed == faultrecon._DOOR


def test_importing_the_package_loads_the_standard_library_alone():
    code = (
        "import sys; before = set(sys.modules); import faultrecon\n"
        "new = {m.split('.')[0] for m in set(sys.modules) - before} - set(sys.stdlib_module_names)\n"
        "print(sorted(new))"
    )
    source = str(ROOT.parent)
    answer = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, {source!r})\n" + code],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert answer.stdout.strip() == "['faultrecon']"


def test_unknown_names_are_no_attributes():
    with pytest.raises(AttributeError, match="has no attribute 'desing'"):
        _ = faultrecon.desing


@pytest.mark.parametrize("path", [p for p in RELATIVE if not p.endswith("__main__.py")])
def test_every_module_imports_on_its_own(path):
    module = "faultrecon." + path.removesuffix(".py").replace("/", ".")
    assert importlib.import_module(module.removesuffix(".__init__"))


# ---------------------------------------------------------------- style that can be counted


@pytest.mark.parametrize("path", RELATIVE)
def test_files_are_licensed_documented_short_and_finished(path):
    text = (ROOT / path).read_text(encoding="utf-8")
    lines = text.splitlines()
    assert lines[0] == "# SPDX-License-Identifier: BSD-3-Clause"
    assert ast.get_docstring(ast.parse(text)), "no docstring"
    assert len(lines) < 400 or path in LONG_FILES
    assert not re.search(r"\b(TODO|FIXME|XXX|HACK)\b", text)
    # Abstract methods of a base class say so with @abstractmethod; anything else that is not implemented is a stub.
    raised = {ast.unparse(n.exc) for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Raise) and n.exc}
    assert not raised & {"NotImplementedError", "NotImplementedError()"}


@pytest.mark.parametrize("path", RELATIVE)
def test_functions_are_short(path):
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            length = node.end_lineno - node.lineno + 1
            assert length < 60 or f"{path}:{node.name}" in LONG_FUNCTIONS, f"{path}:{node.name} has {length} lines"


@pytest.mark.parametrize("path", sorted(Path(__file__).parents[1].rglob("*.py")), ids=lambda p: p.name)
def test_tests_are_licensed_and_none_is_skipped(path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# SPDX-License-Identifier: BSD-3-Clause\n")
    names = {ast.unparse(n) for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Attribute)}
    assert not {n for n in names if n.endswith((".skip", ".skipif", ".xfail", ".importorskip"))}
