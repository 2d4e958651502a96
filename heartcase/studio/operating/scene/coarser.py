"""Coarser levels of detail of the surface that is operated on: what slow pages draw while it moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heartcase.schemas.arrays import Int32
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.live.newest_worker import NewestWorker
from heartcase.simulator.live.shapes import structures_after_cuts
from heartcase.simulator.load import load_case
from heartcase.simulator.surface.deform import SurfaceModel
from heartcase.simulator.surface_splitting.cuttable_surface import CuttableSurface
from heartcase.simulator.surface_splitting.split_surface import SplitSurface, split_surface

__all__ = ["CoarseLevel", "CoarserWorker", "load_coarser"]


@dataclass(frozen=True)
class CoarseLevel:
    """The surface at a coarser level of detail."""

    level: int
    """Level of detail, from 1."""
    surface: SurfaceModel
    """What its vertices follow, and its triangles."""
    structures: Int32
    """Structure of each triangle, shape (triangle_count,)."""


def load_coarser(path: Path) -> tuple[CoarseLevel, ...]:
    """All coarser levels of a case, from finer to coarser; none where it has one level.

    Parameters
    ----------
    path
        The case's folder.

    Raises
    ------
    BundleError
        The bundle is broken.
    """
    found = []
    for level in open_bundle(path).levels:
        if level == 0:
            continue
        case = load_case(path, needs=("surface", "structures"), level=level)
        assert case.surface is not None
        assert case.triangle_structures is not None
        found.append(CoarseLevel(level, case.surface, case.triangle_structures.astype(np.int32)))
    return tuple(found)


class CoarserWorker(NewestWorker[LiveFrame, tuple[SurfaceModel, tuple[CoarseLevel, ...]]]):
    """A thread that has coarser levels follow what is cut.

    ``newest`` is the last result: the finest surface that it goes with, and each level as it is cut.

    Parameters
    ----------
    levels
        The levels before any cut.
    heard
        Called by the thread whenever they have followed.
    """

    def __init__(self, levels: tuple[CoarseLevel, ...], heard: Callable[[], None]) -> None:
        self._levels = levels
        self._cuttable: dict[int, CuttableSurface] = {}
        self._splits: dict[int, SplitSurface] = {}
        super().__init__(
            lambda live: (live.surface, self._follow(live.tissue_cuts)), name="coarser levels", heard=heard
        )

    def _follow(self, cuts: Cuts | None) -> tuple[CoarseLevel, ...]:
        if cuts is None or cuts.parted is None:
            return self._levels
        found = []
        for one in self._levels:
            if one.level not in self._cuttable:
                self._cuttable[one.level] = CuttableSurface.of(cuts.uncut, one.surface)
            before = self._splits.get(one.level)
            split = split_surface(self._cuttable[one.level], cuts.parted, cuts.sheets, before)
            self._splits[one.level] = split
            structures = structures_after_cuts(one.structures, split.triangle_origin)
            found.append(CoarseLevel(one.level, split.surface, structures))
        return tuple(found)
