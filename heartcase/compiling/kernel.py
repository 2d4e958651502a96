"""The decorator of all kernels, and the cache that they are kept in."""

from __future__ import annotations

import inspect
import os
import pickle
from collections.abc import Callable
from typing import Any, overload

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from heartcase.compiling.one_at_a_time import compiled_by_one
from heartcase.compiling.sources import source_stamp

__all__ = ["KERNELS", "cache_folder", "kernel"]

KERNELS: list[Any] = []
"""Dispatchers of all kernels of the modules that are loaded, in the order of their definition."""


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
    # Nobody calls a kernel by address from C, and the wrapper for it takes a twentieth of the time of compiling.
    dispatcher: Any = numba.njit(**{"nogil": True, "no_cfunc_wrapper": True} | options)(function)
    if cached:
        dispatcher._cache = _KernelCache(function)
        lock = os.path.join(dispatcher._cache.cache_path, f"{dispatcher._cache._impl.filename_base}.lock")
        dispatcher.compile = compiled_by_one(dispatcher.compile, dispatcher.overloads.__contains__, lock)
    KERNELS.append(dispatcher)
    return dispatcher


def cache_folder(function: Callable[..., Any]) -> str:
    """Folder of numba's cache for a function's module.

    Raises
    ------
    RuntimeError
        There is no place for a cache.
    """
    return str(FunctionCache(function)._cache_path)


class _KernelCacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
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

    def _load_data(self, name: str) -> Any:
        try:
            return super()._load_data(name)
        except OSError:
            raise
        except Exception:
            raise OSError(f"{name} is damaged") from None  # which numba takes as absent


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
