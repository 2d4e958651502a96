"""Only kernels go without types, and the list of the modules that hold some is right."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator

from tests.structure.test_rooms import PACKAGE, modules

DECORATORS = {"kernel", "loop_kernel", "copied", "called", "compiled", "intrinsic", "cuda.jit", "_inlined"}
"""Of functions that numba compiles, and so finds the types of."""


def untyped(source: str) -> Iterator[ast.FunctionDef]:
    """Functions of a source of which neither an argument nor the result has a type, outermost ones only."""
    waiting: list[ast.AST] = [ast.parse(source)]
    while waiting:
        for node in ast.iter_child_nodes(waiting.pop()):
            if isinstance(node, ast.FunctionDef) and _has_no_type(node):
                yield node
            else:
                waiting.append(node)


def _has_no_type(function: ast.FunctionDef) -> bool:
    given = function.args
    several = [argument for argument in (given.vararg, given.kwarg) if argument is not None]
    arguments = [*given.posonlyargs, *given.args, *given.kwonlyargs, *several]
    return function.returns is None and not any(argument.annotation for argument in arguments)


def is_kernel(function: ast.FunctionDef) -> bool:
    names = (node.func if isinstance(node, ast.Call) else node for node in function.decorator_list)
    return any(ast.unparse(name) in DECORATORS for name in names)


def test_only_kernels_have_no_types():
    bare = {
        f"{name}.{function.name}"
        for name, file in modules().items()
        for function in untyped(file.read_text())
        if not is_kernel(function)
    }
    assert bare == set()


def test_the_list_of_modules_with_kernels_is_complete():
    settings = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    (listed,) = [each["module"] for each in settings if each.get("disallow_untyped_defs") is False]
    assert listed == sorted(name for name, file in modules().items() if any(untyped(file.read_text())))


def test_a_function_without_types_is_found_at_any_depth():
    source = """
@kernel
def a(x):
    def b(y): ...
class C:
    def d(self) -> int:
        def e(): ...
def f(x, y: int): ...
"""
    found = list(untyped(source))
    assert [(each.name, is_kernel(each)) for each in sorted(found, key=lambda each: each.name)] == [
        ("a", True),
        ("e", False),
    ]
