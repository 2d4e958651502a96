"""The decorator of all kernels, and the cache that they are kept in."""

from __future__ import annotations

import contextlib
import inspect
import os
import pickle
import uuid
from collections.abc import Callable, Iterator
from functools import partial
from typing import IO, Any, overload

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from heartcase.compiling.compile_lock import compiled_by_one
from heartcase.compiling.hearing import compiling_now, tell_of_compiling
from heartcase.compiling.loops import LoopKernel
from heartcase.compiling.operators import remembered_operators
from heartcase.compiling.shape_errors import short_shape_errors
from heartcase.compiling.sources import source_stamp
from heartcase.compiling.unneeded_work import without_unneeded_work

__all__ = ["KERNELS", "cache_folder", "kernel", "loop_kernel", "write_unfinished_to"]

KERNELS: list[Any] = []
"""Dispatchers of all kernels of the modules that are loaded, in the order of their definition."""
_unfinished = ""
"""Folder for files of the cache that are being written; empty for the folder in which they will be."""


@overload
def kernel(function: Callable[..., Any], /, *, cached: bool = True, **options: Any) -> Any: ...


@overload
def kernel(*, cached: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]: ...


def kernel(function: Callable[..., Any] | None = None, /, *, cached: bool = True, **options: Any) -> Any:
    """Make a kernel: a function that numba compiles when it is first called with arguments of some types.

    It runs without the interpreter's lock, and what was compiled is kept for the processes that follow, until its
    module or one that this imports changes.

    Parameters
    ----------
    function
        The function; without one, a decorator is returned.
    cached
        Whether what is compiled is kept. Not worth it for what is only copied into other kernels.
    options
        Other options of ``numba.njit``.
    """
    if function is None:
        return lambda given: kernel(given, cached=cached, **options)
    dispatcher = _compiled(function, cached=cached, options=options)
    KERNELS.append(dispatcher)
    return dispatcher


def loop_kernel(function: Callable[..., Any]) -> LoopKernel:
    """Make a kernel whose loop over ``prange`` several threads share: see :mod:`heartcase.compiling.loops`.

    Python calls it; other kernels cannot. It is for functions that only assign names and then run one such loop, in
    which no name is a sum over it. Others are ``kernel(parallel=True)``, which takes twice as long to compile.
    """
    # A division by zero gives what it gives in NumPy, as in numba's own parallel loops.
    shared = LoopKernel(function, partial(_compiled, cached=True, options={"error_model": "numpy"}))
    KERNELS.append(shared)
    return shared


def _compiled(function: Callable[..., Any], *, cached: bool, options: dict[str, Any]) -> Any:
    """Numba's dispatcher of a function, with the cache."""
    # Nobody calls a kernel by its address: the wrapper for that need not be compiled.
    dispatcher: Any = numba.njit(**{"nogil": True, "no_cfunc_wrapper": True} | options)(function)
    if cached:

        def lock() -> str:
            # Made for the kernels that are called alone: for all at import it would take a fifth of a second.
            if not isinstance(dispatcher._cache, _KernelCache):
                dispatcher._cache = _KernelCache(function)
            return os.path.join(dispatcher._cache.cache_path, f"{dispatcher._cache._impl.filename_base}.lock")

        compile_it = dispatcher.compile

        def compile_quickly(signature: Any) -> Any:
            with compiling_now(), short_shape_errors(), remembered_operators(), without_unneeded_work():
                return compile_it(signature)

        dispatcher.compile = compiled_by_one(compile_quickly, dispatcher.overloads.__contains__, lock)
    return dispatcher


def cache_folder(function: Callable[..., Any]) -> str:
    """Folder of numba's cache for a function's module.

    Raises
    ------
    RuntimeError
        There is no place for a cache.
    """
    return str(FunctionCache(function)._cache_path)


def write_unfinished_to(folder: str) -> None:
    """Have this process write files of the cache in a folder, from which they are moved when they are whole.

    So what a process leaves that is killed can be told from what others are writing.

    Parameters
    ----------
    folder
        On the same file system as the cache, otherwise it is not used; empty for where numba writes them.
    """
    global _unfinished
    _unfinished = folder


_writable: set[str] = set()
"""Folders of the cache that were found to be writable."""


def _looking_once(locator: Any) -> Any:
    """One of numba's ways to find a folder for a cache: it tries to write into a folder for each function anew."""

    class Once(locator):  # type: ignore[misc]
        def ensure_cache_path(self) -> None:
            path = self.get_cache_path()
            if path in _writable:
                os.makedirs(path, exist_ok=True)  # somebody may have removed it
                return
            super().ensure_cache_path()
            _writable.add(path)

    return Once


class _KernelCacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = [_looking_once(one) for one in CompileResultCacheImpl._locator_classes]

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Load a function, so that what is compiled with it knows what has to be bound for it.

        numba binds that when it loads the function, and does not keep it: a kernel that was compiled with code from
        the cache, in the process after, was loaded without what this code calls, and brought the whole process down.
        """
        found = super().rebuild(target_context, payload)
        found.library._reload_init.update(found.reload_init)
        return found


class _StampedIndex(IndexDataCacheFile):  # type: ignore[misc]
    """numba's index of what is kept of a function, with the stamp in front of the rest.

    The rest names classes of modules that a newer heartcase may not have any more. numba reads it before it compares
    the stamp, and fails.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._version = f"{numba.__version__}, stamp first"

    def _load_index(self) -> dict[Any, str]:
        try:
            with open(self._index_path, "rb") as file:
                if pickle.load(file) != self._version or pickle.load(file) != self._source_stamp:
                    return {}
                return dict(pickle.loads(file.read()))
        except Exception:  # none yet, or a damaged one, which can raise anything and costs no more than compiling again
            return {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        with self._open_for_write(self._index_path) as file:
            pickle.dump(self._version, file)
            pickle.dump(self._source_stamp, file)
            file.write(self._dump(overloads))

    @contextlib.contextmanager
    def _open_for_write(self, path: str) -> Iterator[IO[bytes]]:
        if not (_unfinished and _is_same_system(_unfinished, os.path.dirname(path))):
            with super()._open_for_write(path) as file:
                yield file
            return
        temporary = os.path.join(_unfinished, uuid.uuid4().hex)
        with open(temporary, "wb") as file:
            yield file
        os.replace(temporary, path)

    def _load_data(self, name: str) -> Any:
        try:
            return super()._load_data(name)
        except OSError:
            raise
        except Exception:
            raise OSError(f"{name} is damaged") from None  # which numba takes as absent


def _is_same_system(one: str, other: str) -> bool:
    try:
        return os.stat(one).st_dev == os.stat(other).st_dev
    except OSError:
        return False


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, which is fresh as long as all the source that it was compiled from is the same."""

    _impl_class = _KernelCacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        file = inspect.getfile(function)
        if not os.path.exists(file):
            return  # in a zip archive or a frozen program numba takes the stamp of the whole
        self._cache_file = _StampedIndex(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=source_stamp(file),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What the cache has; where it has nothing, numba compiles, and who wants to hear of it is told."""
        found = super().load_overload(sig, target_context)
        if found is None:
            tell_of_compiling()
        return found
