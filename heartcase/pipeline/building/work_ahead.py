"""Work of the last stage and of the report, begun as soon as what it takes is there: other stages leave cores idle."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from importlib import import_module
from types import TracebackType
from typing import TYPE_CHECKING, Any

from heartcase.pipeline.data import Surface
from heartcase.pipeline.kernels.parallel import background_worker, may_share
from heartcase.pipeline.stages.segment import filtered_tree
from heartcase.pipeline.stages.stage import Work
from heartcase.schemas.arrays import Float32

if TYPE_CHECKING:
    from heartcase.pipeline.markers.confidence import Sureness

__all__ = ["WorkAhead", "sureness"]


class WorkAhead:
    """A thread for it; as a context, what nobody asked for is given up at its end.

    Parameters
    ----------
    work
        What the stages have made so far; told of what is begun.
    """

    def __init__(self, work: Work) -> None:
        self._work = work
        self._is_over = False
        self._pool = background_worker("heartcase-ahead")

    def __enter__(self) -> WorkAhead:
        """Nothing is begun yet."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Give up what is not begun, and wait for what is: not for long."""
        self._is_over = True
        self._pool.shutdown(cancel_futures=True)

    def look(self) -> None:
        """Begin what can be begun, where the stages have computed, and not found, what it takes."""
        from heartcase.pipeline.bundle.assembly import normal_maps, structure_figures

        recipe, outputs = self._work.recipe, self._work.outputs
        if outputs.structures is not None and outputs.structures.value is not None:
            structures = outputs.structures.value
            # Writing the labels takes it, and loading it takes a tenth of a second.
            self._begin("library", lambda: import_module("SimpleITK"))
            self._begin("structure_figures", lambda: structure_figures(recipe, structures, lambda: not self._is_over))
        if outputs.surface is not None and outputs.surface.value is not None:
            surface = outputs.surface.value
            self._begin("normal_maps", lambda: normal_maps(recipe, surface))
            if outputs.grid_map is not None:
                # The report's: any earlier the case would have to wait for it.
                self._begin("thickness", lambda: _thickness_mm(surface))
                if all(one is not None and one.value is not None for one in (outputs.filtered, outputs.markers)):
                    self._begin("sureness", lambda: sureness(self._work))

    def _begin(self, name: str, function: Callable[[], Any]) -> None:
        if name not in self._work.begun and may_share():
            future: Future[Any] = self._pool.submit(function)
            self._work.begun[name] = future.result


def _thickness_mm(surface: Surface) -> Float32:
    # Loaded here, so that what the case waits for does not wait for the report's modules.
    from heartcase.pipeline.report.report_pictures import surface_thickness_mm

    return surface_thickness_mm(surface)


def sureness(work: Work) -> Sureness | None:
    """How sure the watershed is, from the tree that the cache keeps; None for other methods."""
    from heartcase.pipeline.markers.confidence import sureness_of

    if work.outputs.markers is None:
        return None
    return sureness_of(filtered_tree(work), work.outputs.markers.get())
