"""Kernels whose loop several threads share: compiled once for a part of the loop, called for one part after the other.

numba compiles such a kernel twice, as a whole and as its loop's body, and gives each thread a fixed share of it. Here
the loop's bounds become those of a part, and threads take the next part when they are done with one. So compiling takes
about half as long, and a thread that is held up by something else holds up nobody.

As in numba's own parallel loops, no references to the arrays are counted: the caller keeps them. Where a loop hands
them on at each turn, all threads counting in the same places took twice as long as the work.
"""

from __future__ import annotations
import __future__

import ast
import inspect
import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache, cached_property, update_wrapper
from types import FunctionType
from typing import Any, cast

import numba

from heartcase.compiling.tuple_addresses import uncounted

__all__ = ["PARTS_A_THREAD", "PART_TYPES", "LoopKernel", "loop_part"]

PARTS_A_THREAD = 4
"""Parts of a loop for each thread: the last of them ends soon after the others."""
PART_TYPES = (numba.int64, numba.int64)
"""Types of the arguments that say which part of how many."""
_ANNOTATIONS = __future__.annotations.compiler_flag
"""Types of arguments are text in what is made here as they are in our modules."""
_PART = """
def part(part_, parts_):
    begin_ = begin
    length_ = end - begin_
    for index in range(begin_ + length_ * part_ // parts_, begin_ + length_ * (part_ + 1) // parts_):
        pass
"""


class LoopKernel:
    """What a kernel with a loop is called by: it shares its loop out among this thread and others.

    Parameters
    ----------
    function
        Of a module. It only assigns names and then runs one loop over ``prange``, in which neither these nor
        its arguments are set.
    make
        Makes the kernel of one part, from :func:`loop_part`.
    """

    def __init__(self, function: Callable[..., Any], make: Callable[[Callable[..., Any]], Any]) -> None:
        self.py_func = function
        self._make = make
        update_wrapper(self, function)

    @cached_property
    def of_part(self) -> Any:
        """Numba's dispatcher of one part, which takes the part and the number of parts before all else."""
        return self._make(loop_part(cast(FunctionType, self.py_func)))

    @property
    def overloads(self) -> dict[tuple[Any, ...], Any]:
        """What is compiled, by the types of the arguments."""
        if "of_part" not in self.__dict__:
            return {}
        return {types[len(PART_TYPES) :]: found for types, found in self.of_part.overloads.items()}

    def compile(self, types: tuple[Any, ...]) -> Any:
        """Compile for some types of arguments, or load from the cache."""
        return self.of_part.compile((*PART_TYPES, *types))

    def __call__(self, *arguments: Any, **named: Any) -> None:
        """Work out the loop.

        Raises
        ------
        Exception
            What a part raised; by then no other one runs any more.
        """
        of_part, thread_count = self.of_part, numba.get_num_threads()
        if thread_count < 2:
            of_part(0, 1, *arguments, **named)
            return
        count = PARTS_A_THREAD * thread_count
        # The interpreter's lock sees to it that each part is taken once.
        parts = iter(range(count))

        def work() -> None:
            for part in parts:
                of_part(part, count, *arguments, **named)

        others: list[Future[None]] = []
        try:
            with suppress(RuntimeError):  # no thread can be had, or the interpreter ends
                for _ in range(thread_count - 1):
                    others.append(_threads().submit(work))
            work()
        finally:
            # After an error here the others end with the parts that they are at.
            for _ in parts:
                pass
            # Threads that others keep busy are not waited for: what they would have done is done.
            errors = _errors_of([other for other in others if not other.cancel()])
        for error in errors:
            raise error


def _errors_of(begun: list[Future[None]]) -> list[BaseException]:
    """What was raised in threads, once all have ended, even if this one is interrupted meanwhile."""
    errors: list[BaseException] = []
    for other in begun:
        while not other.done():
            try:
                wait([other])
            except KeyboardInterrupt as interrupt:
                errors.append(interrupt)
    return errors + [error for other in begun if (error := other.exception()) is not None]


@cache
def _threads() -> ThreadPoolExecutor:
    """The threads that help, for as long as the process lasts: as many as numba would use beside the caller's."""
    return ThreadPoolExecutor(max(1, numba.config.NUMBA_NUM_THREADS - 1), "heartcase-loop")


if hasattr(os, "register_at_fork"):
    # A process that was forked has none of the threads.
    os.register_at_fork(after_in_child=_threads.cache_clear)


def loop_part(function: FunctionType) -> FunctionType:
    """A function for one part of the loop of another one: which of how many are its first arguments.

    Raises
    ------
    ValueError
        The function is not as :class:`LoopKernel` wants it.
    """
    lines, first_line = inspect.getsourcelines(function)
    # Errors name the lines of the function as it is written.
    tree = ast.parse("\n" * (first_line - 1) + "".join(lines))
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)
    loop = _loop_of(definition)
    if loop is None or function.__closure__:
        name = f"{function.__module__}.{function.__qualname__}"
        raise ValueError(f"{name} is no loop_kernel: it does more than assign names and run one loop")
    template = ast.parse(_PART).body[0]
    assert isinstance(template, ast.FunctionDef)
    set_begin, set_length, some = template.body
    assert isinstance(set_begin, ast.Assign)
    assert isinstance(set_length, ast.Assign)
    assert isinstance(some, ast.For)
    assert isinstance(loop.iter, ast.Call)
    assert isinstance(set_length.value, ast.BinOp)
    bounds = loop.iter.args
    set_begin.value = bounds[0] if len(bounds) == 2 else ast.Constant(0)
    set_length.value.left = bounds[-1]
    uncount = ast.parse("\n".join(f"{one.arg} = uncounted_({one.arg})" for one in definition.args.args)).body
    for node in [inner for one in [*uncount, set_begin, set_length, some.iter] for inner in ast.walk(one)]:
        if isinstance(node, (ast.expr, ast.stmt)):
            ast.copy_location(node, loop)
    loop.iter = some.iter
    definition.body = [*uncount, *definition.body[:-1], set_begin, set_length, loop]
    definition.decorator_list = []
    definition.args.args[:0] = template.args.args
    made: dict[str, Any] = {}
    code = compile(tree, inspect.getfile(function), "exec", flags=_ANNOTATIONS, dont_inherit=True)
    exec(code, function.__globals__ | {"uncounted_": uncounted}, made)
    part = made[function.__name__]
    assert isinstance(part, FunctionType)
    part.__defaults__, part.__doc__ = function.__defaults__, function.__doc__
    return part


def _loop_of(definition: ast.FunctionDef) -> ast.For | None:
    """The loop of a function that does nothing else but assign names before."""
    *before, loop = definition.body
    if before and isinstance(before[0], ast.Expr) and isinstance(before[0].value, ast.Constant):
        before = before[1:]
    of_before, within = (list(ast.walk(one)) for one in (ast.Module(before, []), loop))
    nodes = of_before + within
    loops = [node for node in nodes if isinstance(node, ast.Call) and _is_prange(node.func)]
    if not isinstance(loop, ast.For) or loop.orelse or [loop.iter] != loops or len(loops[0].args) > 2:
        return None
    is_plain = all(isinstance(one, ast.Assign) for one in before)
    returns = any(isinstance(node, (ast.Return, ast.Yield, ast.YieldFrom)) for node in nodes)
    known = _names_set(of_before) | {one.arg for one in definition.args.args}
    return loop if is_plain and not returns and not known & _names_set(within) else None


def _is_prange(called: ast.expr) -> bool:
    return (called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")) == "prange"


def _names_set(nodes: list[ast.AST]) -> set[str]:
    return {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
