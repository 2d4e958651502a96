"""How far tissue is stretched, worked out beside the steps: colours follow when they are ready."""

from __future__ import annotations

import threading

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.incisions.strain import cell_strain, values_at_nodes
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.session.frame import Frame

__all__ = ["StrainWorker", "stretch_at_nodes"]


def stretch_at_nodes(frame: Frame) -> Float64:
    """Largest principal stretch around each node of a frame, shape (node_count,)."""
    strain = cell_strain(frame.model, frame.state.displacement)
    # 1 where nothing is known: as at rest.
    return 1.0 + values_at_nodes(frame.model, strain.stretches[:, 0] - 1.0, strain.is_known)


class StrainWorker:
    """A thread that works out the stretch of the newest frame it was given, one after another.

    ``newest`` is the last result: the lattice that it is of, and the stretch around each of its nodes.
    """

    def __init__(self) -> None:
        self.newest: tuple[LatticeModel, Float64] | None = None
        self._frame: Frame | None = None
        self._wake = threading.Condition()
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name="strain", daemon=True)
        self._thread.start()

    def ask(self, frame: Frame) -> None:
        """Work out this frame next; one that waits is left out."""
        with self._wake:
            self._frame = frame
            self._wake.notify_all()

    def close(self) -> None:
        """End the thread."""
        with self._wake:
            self._is_closing = True
            self._wake.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                while self._frame is None and not self._is_closing:
                    self._wake.wait()
                if self._is_closing:
                    return
                frame, self._frame = self._frame, None
            assert frame is not None
            with np.errstate(all="ignore"):
                self.newest = frame.model, stretch_at_nodes(frame)
