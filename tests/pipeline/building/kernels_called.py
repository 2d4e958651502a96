"""Which kernels the build of a sample case calls, and with which types: run as a module, with FOLDER and OUTPUT.

A process of its own builds the adult phantom, with the stages one after the other, and writes for each kernel that
Python called the stage that called it first. What was compiled for it, rather than found in numba's cache, has its
seconds.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numba
from numba.core import event

RECIPE = Path(__file__).parents[3] / "sample_cases" / "adult_phantom.toml"


class _Compiled(event.Listener):
    """Seconds that each kernel took to compile, with what it needs and was not there yet."""

    def __init__(self) -> None:
        self.seconds: dict[tuple, float] = {}
        self.started: list[tuple] = []

    def on_start(self, event) -> None:
        self.started.append((id(event.data["dispatcher"]), tuple(event.data["args"]), time.process_time()))

    def on_end(self, event) -> None:
        *key, start = self.started.pop()
        self.seconds[tuple(key)] = time.process_time() - start


def sample_recipe(folder: Path) -> Path:
    """The adult phantom's, with its scan made in the folder; a coarser one has no flat minimum to try strokes in."""
    path = folder / RECIPE.name
    path.write_text(RECIPE.read_text().replace("../out/adult_phantom/", ""))
    return path


class CalledKernels:
    """Kernels that Python called in this process, and who called each first."""

    def __init__(self) -> None:
        from heartcase.compiling.kernel import KERNELS

        self._kernels = KERNELS
        self._called: dict[tuple, dict] = {}
        self._compiled = _Compiled()
        event.register("numba:compile", self._compiled)

    def note(self, caller: str) -> None:
        """What was called since the last time, this caller called."""
        from heartcase.compiling.loops import PART_TYPES, LoopKernel
        from heartcase.compiling.signatures import as_json

        for kernel in self._kernels:
            function, is_loop = kernel.py_func, isinstance(kernel, LoopKernel)
            is_inner = not is_loop and kernel.targetoptions.get("no_cpython_wrapper")
            if is_inner or not function.__module__.startswith("heartcase."):
                continue
            for types in list(kernel.overloads):
                try:
                    listed = json.dumps([as_json(one) for one in types])
                except ValueError:  # of lent tuples and of constants, which only other kernels hand over
                    continue
                key = (function.__module__, function.__qualname__, listed)
                compiled = (id(kernel.of_part), PART_TYPES + types) if is_loop else (id(kernel), types)
                seconds = self._compiled.seconds.get(compiled, 0.0)
                self._called.setdefault(key, {"stage": caller, "seconds": round(seconds, 2)})

    def write(self, output: Path) -> None:
        """Write all of them."""
        entries = [
            {"module": module, "name": name, "types": json.loads(types)} | facts
            for (module, name, types), facts in self._called.items()
        ]
        output.write_text(json.dumps(entries))


def main(folder: Path, output: Path) -> None:
    numba.set_num_threads(1)  # so that no two stages run at the same time
    from heartcase.library.scans import ensure_scan
    from heartcase.pipeline.building.run import build_case
    from heartcase.schemas.recipe.recipe import load_recipe

    called = CalledKernels()

    class Ear:
        def stage_started(self, stage, *, seconds_expected, seconds_after):
            pass

        def stage_finished(self, stage, *, seconds, reused):
            called.note(stage)

    recipe = load_recipe(sample_recipe(folder))
    ensure_scan(recipe.scan, folder)
    called.note("scan")
    build_case(recipe, directory=folder, out=folder, listener=Ear(), force=True)
    called.write(output)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
