"""Components, tunnels and cavities of voxel sets, with the adjacency that the stage asks for.

Tissue is 26-connected: two cells that share a corner share a node. Blood is 6-connected. A set that is 26-connected
goes with a complement that is 6-connected, and the other way round, so that Jordan's theorem holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Literal

import cc3d
import numpy as np

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.kernels.feature_transform import distance_to_marked
from heartcase.schemas.arrays import Bool, Float32, UInt32

__all__ = ["Betti", "betti_numbers", "components", "distance_in_samples", "euler_characteristic", "piece_sizes"]

Connectivity = Literal[6, 26]


@dataclass(frozen=True)
class Betti:
    """Betti numbers of a set of voxels."""

    components: int
    """Connected pieces, b0."""
    tunnels: int
    """Independent tunnels and handles, b1."""
    cavities: int
    """Enclosed cavities, b2."""

    def as_list(self) -> list[int]:
        """``[b0, b1, b2]``."""
        return [self.components, self.tunnels, self.cavities]


def components(mask: Bool, connectivity: Connectivity) -> tuple[UInt32, int]:
    """Label the connected pieces of a mask from 1 on, in raster order of their first voxel.

    Returns
    -------
    labels
        uint32, the mask's shape; 0 outside the mask.
    count
        Number of pieces.
    """
    if not mask.any():
        return np.zeros(mask.shape, np.uint32), 0
    labels, count = cc3d.connected_components(
        np.ascontiguousarray(mask), connectivity=connectivity, return_N=True, out_dtype=np.uint32
    )
    return labels, int(count)


@kernel
def piece_sizes(labels, count):
    """Voxels of each number up to ``count``; ``labels`` is flat."""
    sizes = np.zeros(count + 1, np.int64)
    for n in range(len(labels)):
        sizes[labels[n]] += 1
    return sizes


def distance_in_samples(mask: Bool) -> Float32:
    """Distance of each point of a mask to the nearest point off it, in samples; the array's border is not off it."""
    distance = np.empty(mask.shape, np.float32)
    distance_to_marked(~mask, np.ones(3), distance)
    return distance


def euler_characteristic(mask: Bool, connectivity: Connectivity) -> int:
    """Euler characteristic of a mask.

    With 26 neighbours the set is the union of closed cubes: vertices - edges + faces - cubes that any voxel touches.
    With 6 neighbours it is the complex on voxel centres: points - edges + squares - cubes whose voxels are all set.
    """
    padded = np.pad(mask, 1)
    total = 0
    for axes in product((False, True), repeat=3):
        cells = padded
        for axis, wide in enumerate(axes):
            if wide:
                low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
                high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
                cells = cells[low] | cells[high] if connectivity == 26 else cells[low] & cells[high]
        # Spanning d axes gives (3 - d)-cells of the union of cubes, but d-cells of the complex on centres.
        sign = (-1) ** (3 - sum(axes)) if connectivity == 26 else (-1) ** sum(axes)
        total += sign * int(np.count_nonzero(cells))
    return total


def betti_numbers(mask: Bool, connectivity: Connectivity) -> Betti:
    """Betti numbers of a mask; what lies beyond the array is not part of it.

    Parameters
    ----------
    mask
        Voxels of the set, any shape with three axes.
    connectivity
        6 or 26; the complement has the other one.
    """
    dual: Connectivity = 6 if connectivity == 26 else 26
    pieces = components(mask, connectivity)[1]
    around = components(np.pad(~mask, 1, constant_values=True), dual)[1]
    cavities = around - 1
    return Betti(pieces, pieces + cavities - euler_characteristic(mask, connectivity), cavities)
