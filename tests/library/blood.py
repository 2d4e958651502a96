"""Where blood of a case can go, with the walls as they are: voxels of its labels, joined where nothing is between."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from heartcase.pipeline.formats.read_scan import read_labels
from heartcase.simulator.incisions.segments import touches
from heartcase.simulator.incisions.triangle_tree import TriangleTree


@dataclass(frozen=True)
class Blood:
    """Voxels of some labels of a case."""

    places_mm: np.ndarray
    """Their middles, LPS mm, shape (count, 3)."""
    labels: np.ndarray
    """Shape (count,)."""
    links: np.ndarray
    """Pairs of voxels that share a face, shape (any, 2)."""

    @classmethod
    def of_case(cls, path: Path, labels: tuple[int, ...]) -> Blood:
        """Of the labels of a case on disk."""
        (file,) = path.glob("labels*.seg.nrrd")
        volume = read_labels(file)
        is_blood = np.isin(volume.values, labels)
        voxels = np.argwhere(is_blood)
        number = np.full(np.add(volume.values.shape, 1), -1)
        number[tuple(voxels.T)] = np.arange(len(voxels))
        links = []
        for axis in range(3):
            beside = number[tuple((voxels + np.eye(3, dtype=int)[axis]).T)]
            here = np.flatnonzero(beside >= 0)
            links.append(np.stack([here, beside[here]], axis=1))
        places = volume.geometry.index_to_world(voxels[:, ::-1].astype(float))
        return cls(np.asarray(places), volume.values[tuple(voxels.T)], np.concatenate(links))

    def compartments(self, walls: list[TriangleTree], gap_mm: float) -> np.ndarray:
        """Number of the part that each voxel lies in, shape (count,).

        No link through a wall counts, nor one that has less than half of a gap on any side.
        """
        start, end = self.places_mm[self.links].transpose(1, 0, 2)
        is_open = np.ones(len(start), bool)
        for wall in walls:
            is_open &= ~touches(wall, start, end, 0.5 * gap_mm)
        one, other = self.links[is_open].T
        graph = coo_array((np.ones(len(one)), (one, other)), shape=(len(self.labels),) * 2)
        return connected_components(graph, directed=False)[1]

    def nearest(self, label: int, point_mm: tuple[float, float, float]) -> int:
        """The voxel of a label that is nearest to a point."""
        among = np.flatnonzero(self.labels == label)
        return int(among[np.linalg.norm(self.places_mm[among] - point_mm, axis=1).argmin()])
