"""What kernels may not do, read off the source: lean on numba's inside, or on how one Python compiles a branch."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

import heartcase
from heartcase.compiling.versions import FIRST_NUMBA, LAST_NUMBA, check_numba
from heartcase.schemas.errors import UnsupportedVersionError

PACKAGE = Path(heartcase.__file__).parent
SOURCES = {file.relative_to(PACKAGE).as_posix(): file.read_text() for file in sorted(PACKAGE.rglob("*.py"))}


def branching_reductions(source: str) -> list[int]:
    """Lines of parallel loops where a variable is joined with the value of a branch.

    numba finds the reductions of a parallel loop by following each variable back to itself. Where the value that is
    joined is the outcome of ``or``, ``and``, ``if else`` or a chain of comparisons, the byte code from Python 3.12 on
    branches there, and numba loses its way ("unexpected cycle in lookup").
    """
    found = []
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef):
            continue
        if not any("parallel=True" in ast.unparse(one) for one in function.decorator_list):
            continue
        for loop in ast.walk(function):
            if isinstance(loop, ast.For) and "prange" in ast.unparse(loop.iter):
                outer = {
                    name.id
                    for statement in function.body
                    for name in ast.walk(statement)
                    if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store) and not _within(name, loop)
                }
                found += [node.lineno for node in ast.walk(loop) if _joins_branch(node, outer)]
    return found


def _within(node: ast.Name, loop: ast.For) -> bool:
    return loop.lineno <= node.lineno <= (loop.end_lineno or loop.lineno)


def _joins_branch(node: ast.AST, outer: set[str]) -> bool:
    if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
        name, value = node.target.id, node.value
    elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
        name, value = node.targets[0].id, node.value
        if name not in {one.id for one in ast.walk(value) if isinstance(one, ast.Name)}:
            return False
    else:
        return False
    return name in outer and any(
        isinstance(one, ast.BoolOp | ast.IfExp) or (isinstance(one, ast.Compare) and len(one.ops) > 1)
        for one in ast.walk(value)
    )


LOOP = """
@kernel(parallel=True)
def f(a):
    lost = 0
    for n in prange(len(a)):
        u = a[n] if a[n] > 0 else 1
        u = u if u < 5 or u > 9 else 0
        {}
    return lost
"""


def test_no_reduction_of_a_parallel_loop_takes_the_value_of_a_branch():
    for line in (
        "lost += a[n] != 1 or u == 2",
        "lost = lost + (1 if u else 0)",
        "lost = max(lost, u and 3)",
        "lost += 0 < u < 3",
    ):
        assert branching_reductions(LOOP.format(line)) == [8], line
    assert branching_reductions(LOOP.format("lost += u")) == []
    assert {name: lines for name, text in SOURCES.items() if (lines := branching_reductions(text))} == {}


@pytest.mark.parametrize("pattern", [r"numba\.core", r"llvmlite\.binding", r"\bnjit\b|\bnumba\.jit\b"])
def test_numbas_inside_is_used_in_one_folder(pattern):
    users = {name for name, text in SOURCES.items() if re.search(pattern, text)}
    assert users
    assert {name.split("/")[0] for name in users} == {"compiling"}


def test_the_range_of_numba_is_that_of_the_package():
    declared = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]["dependencies"]
    first = "{}.{}".format(*FIRST_NUMBA)
    after = f"{LAST_NUMBA[0]}.{LAST_NUMBA[1] + 1}"
    assert f"numba>={first},<{after}" in declared


@pytest.mark.parametrize("version", ["0.60.0", "0.69.0rc1", "1.0.0", "unknown"])
def test_another_numba_is_refused_with_what_to_do(version):
    with pytest.raises(UnsupportedVersionError, match=f"numba {version} is installed.*pip install 'numba>="):
        check_numba(version)
    assert issubclass(UnsupportedVersionError, ImportError)


@pytest.mark.parametrize("version", ["{}.{}.0".format(*FIRST_NUMBA), "{}.{}.7".format(*LAST_NUMBA)])
def test_a_tested_numba_is_taken(version):
    check_numba(version)
