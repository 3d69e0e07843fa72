"""The project around the code: import time, floors, docstrings, declared packages."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from tree import ROOT, printed

PACKAGES = ("factors", "graphnav")
HEAVY = {"gtsam", "numba", "scipy", "pyarrow", "matplotlib", "pydantic", "rich", "open3d", "cv2"}

#: The floors, lowest first; a name is a module or a package with all that is in it.
FLOORS = (
    {
        "graphnav.errors",
        "graphnav._hints",
        "graphnav._schema",
        "graphnav._memory",
        "graphnav._outputs",
        "graphnav._pool",
        "graphnav._stages",
        "graphnav.methods",
        "graphnav.records",
        "graphnav.log",
        "graphnav.trajectory",
        "factors",
    },
    {
        "graphnav.readers",
        "graphnav.frontends",
        "graphnav.baselines",
        "graphnav._config_base",
        "graphnav._config_errors",
        "graphnav.camera_config",
        "graphnav.config",
        "graphnav.filter_config",
        "graphnav.evaluation",
        "graphnav._metrics",
        "graphnav._drift",
        "graphnav._directions",
        "graphnav._observability",
        "graphnav._consistency",
        "graphnav._coverage",
        "graphnav._cycles",
        "graphnav._statistics",
    },
    {
        "graphnav.keyframes",
        "graphnav.simulation",
        "graphnav.report",
        "graphnav.run",
        "graphnav.limits",
        "graphnav.comparison",
        "graphnav.creep_rows",
        "graphnav._seeds",
    },
    {
        "graphnav.graph",
        "graphnav.native_factors",
        "graphnav.camera",
        "graphnav.motions",
        "graphnav.camera_errors",
        "graphnav.tracks",
        "graphnav.chain_graph",
        "graphnav.chain_problem",
        "graphnav.chain_ranges",
        "graphnav.markov_errors",
        "graphnav.ranges",
        "graphnav.legs",
        "graphnav.leg_advances",
        "graphnav.leg_means",
        "graphnav.leg_sums",
        "graphnav.leg_priors",
        "graphnav.initial",
        "graphnav.problem",
        "graphnav.anchor_priors",
        "graphnav.preintegration",
    },
    {
        "graphnav.solvers",
        "graphnav.observability",
        "graphnav.leg_agreement",
        "graphnav.agreement",
        "graphnav.costs",
        "graphnav.range_clock",
        "graphnav.camera_score",
    },
    {
        "graphnav.smooth",
        "graphnav.outcome",
        "graphnav.scanned",
        "graphnav.sighted",
        "graphnav.rounds",
        "graphnav.solved",
        "graphnav.solution",
        "graphnav.filtered",
        "graphnav.leg_filtered",
        "graphnav.ranged",
        "graphnav.stereo_filtered",
        "graphnav.chained",
        "graphnav.analysis",
        "graphnav.compare",
        "graphnav.bound",
        "graphnav.stops",
        "graphnav.face_line",
        "graphnav.creep",
        "graphnav.anchor_doubt",
        "graphnav.rival_paths",
        "graphnav.range_outcome",
        "graphnav.holes",
        "graphnav.range_rounds",
        "graphnav.camera_outcome",
        "graphnav.camera_clock",
    },
    {"graphnav.cli", "graphnav.__main__", "graphnav.commands", "graphnav.log_commands", "graphnav.demo"},
)


# Modules and what they import -------------------------------------------------------------------------------


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {module_name(p): p for package in PACKAGES for p in sorted((ROOT / package).rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in SOURCES.items()}


def imports(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Every (module, name) imported anywhere in a file, in functions and under TYPE_CHECKING too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import of {node.module}"
            yield from ((node.module or "", alias.name) for alias in node.names)


def own_imports(module: str) -> set[str]:
    """Modules of this project that a module imports, each named as precisely as it can be."""
    found = set()
    for target, name in imports(TREES[module]):
        if target.split(".")[0] in PACKAGES:
            inner = f"{target}.{name}"
            found.add(inner if inner in SOURCES else target)
    return found - {module}


def floor(module: str) -> int:
    """1 for the lowest; fails for a module that is on none."""
    parts = module.split(".")
    prefixes = {".".join(parts[:n]) for n in range(1, len(parts) + 1)}
    found = [number for number, names in enumerate(FLOORS, 1) if names & prefixes]
    assert len(found) == 1, f"{module} is on floors {found}, expected one: add it to FLOORS or move it"
    return found[0]


MODULES = sorted(SOURCES.keys() - {"graphnav"})  # graphnav/__init__.py is the public face of all floors


@pytest.mark.parametrize("module", MODULES)
def test_imports_point_down(module: str) -> None:
    own = floor(module)
    too_high = {target for target in own_imports(module) - {"graphnav"} if floor(target) > own}
    assert not too_high, f"{module} (floor {own}) imports from above: {sorted(too_high)}"


@pytest.mark.parametrize("module", MODULES)
def test_the_public_face_is_not_used_inside(module: str) -> None:
    names = {name for target, name in imports(TREES[module]) if target == "graphnav"}
    inside = names - {"__version__"} - {name.removeprefix("graphnav.") for name in SOURCES}
    assert not inside, f"{module} takes {sorted(inside)} from graphnav: import it from where it is defined"


def test_no_import_circles() -> None:
    try:
        order = list(TopologicalSorter({module: own_imports(module) for module in MODULES}).static_order())
    except CycleError as error:
        pytest.fail(f"circle: {' <- '.join(error.args[1])}")
    assert set(MODULES) <= set(order)


def test_factors_stand_alone() -> None:
    outside = {(m, t) for m in MODULES for t in own_imports(m) if m.startswith("factors") and "graphnav" in t}
    assert not outside


def test_third_party_imports_are_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {re.match(r"[\w-]+", line)[0].replace("-", "_") for line in project["dependencies"]}
    modules = {"PIL": "pillow"}  # whose package has another name
    targets = {target.split(".")[0] for tree in TREES.values() for target, _ in imports(tree)}
    used = {modules.get(target, target) for target in targets}
    assert used - set(sys.stdlib_module_names) - set(PACKAGES) <= declared


def test_lock_has_every_direct_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["dev"]
    lines = (ROOT / "requirements.lock").read_text().splitlines()
    locked = [line for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9-]+==[\w.]+", line) for line in locked)
    assert {re.match(r"[\w-]+", line)[0] for line in wanted} <= {line.split("==")[0] for line in locked}


# Docstrings -------------------------------------------------------------------------------------------------


def undocumented(module: str) -> list[str]:
    """Public functions, classes and methods of a module that have no docstring."""
    nodes = [(TREES[module], module)]
    missing = []
    while nodes:
        node, name = nodes.pop()
        if ast.get_docstring(node) is None:
            missing.append(name)
        for child in node.body:
            inside_function = isinstance(node, ast.FunctionDef)
            named = isinstance(child, ast.FunctionDef | ast.ClassDef) and not inside_function
            if named and not child.name.startswith("_"):
                nodes.append((child, f"{name}.{child.name}"))
    return missing


@pytest.mark.parametrize("module", sorted(SOURCES))
def test_every_public_function_has_a_docstring(module: str) -> None:
    assert not undocumented(module)


# The public face --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("statement", ["import graphnav", "from graphnav import SensorLog", "import graphnav.cli"])
def test_import_loads_nothing_heavy(statement: str) -> None:
    code = f"{statement}\nimport sys\nprint(*sorted({HEAVY!r} & set(sys.modules)))"
    assert printed(code) == ""


@pytest.mark.parametrize(
    "before",
    [
        "",
        "import graphnav.smooth",
        "from graphnav.smooth import Run",
        "from graphnav import Run",
        "from graphnav import smooth",
        "import graphnav as gn; gn.smooth; import graphnav.smooth",
        "import graphnav.smooth as module; assert module.smooth is not module; assert module.Run",
    ],
)
def test_smooth_is_callable_however_it_was_imported(before: str) -> None:
    code = f"""
{before}
import inspect
import graphnav as gn
from graphnav import smooth
from graphnav.errors import LogError
assert smooth is gn.smooth
assert inspect.signature(gn.smooth) == inspect.signature(gn.smooth.smooth)
try:
    gn.smooth("nowhere")
except LogError as error:
    print(error)
"""
    assert printed(code) == "nowhere: no such folder; check the path"


def test_every_public_name_resolves_and_is_listed() -> None:
    import graphnav as gn

    assert set(gn._PUBLIC) == set(gn.__all__)
    for name in gn.__all__:
        assert getattr(gn, name).__doc__, name
        assert name in dir(gn)
    with pytest.raises(AttributeError, match="no attribute 'smoothe'"):
        _ = gn.smoothe


def test_versions_agree() -> None:
    import graphnav

    newest = re.search(r"^## \[(\d[\w.]*)\]", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest is not None
    assert newest[1] == graphnav.__version__
