"""How far tissue is stretched, worked out beside the steps: colours follow when they are ready."""

from __future__ import annotations

from heartcase.schemas.arrays import Float64
from heartcase.simulator.incisions.strain import cell_strain, values_at_nodes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.live.newest_worker import NewestWorker
from heartcase.simulator.session.frame import Frame

__all__ = ["StrainWorker", "stretch_at_nodes"]


def stretch_at_nodes(frame: Frame) -> Float64:
    """Largest principal stretch around each node of a frame, shape (node_count,)."""
    strain = cell_strain(frame.model, frame.state.displacement)
    # 1 where nothing is known: as at rest.
    return 1.0 + values_at_nodes(frame.model, strain.stretches[:, 0] - 1.0, strain.is_known)


class StrainWorker(NewestWorker[Frame, tuple[LatticeModel, Float64]]):
    """A thread that works out the stretch of the newest frame it was given.

    ``newest`` is the last result: the lattice that it is of, and the stretch around each of its nodes.
    """

    def __init__(self) -> None:
        super().__init__(lambda frame: (frame.model, stretch_at_nodes(frame)), name="strain")
