"""What passes between the servo loop and the simulation: poses of the tool one way, states of the tissue the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.simulator.haptics.coupling import TissueSample
from heartcase.simulator.haptics.hand_over import Ring, shared_memory
from heartcase.simulator.haptics.poses import ToolPose

__all__ = ["Channel", "Felt", "ToolHistory"]

_TISSUE_ROWS, _TISSUE_WIDTH = 4, 21
_TOOL_ROWS, _TOOL_WIDTH = 512, 23


@dataclass(frozen=True)
class ToolHistory:
    """Where a tool was lately."""

    times_s: Float64
    """Times, ascending, s, shape (count,)."""
    positions_mm: Float64
    """Positions, LPS mm, shape (count, 3)."""
    turns: Float64
    """Rotations, LPS axes, shape (count, 3, 3)."""


@dataclass(frozen=True)
class Felt:
    """What the loop put out last."""

    time_s: float
    """When, by the clock of the loop, s."""
    pose: ToolPose
    """Where the tool behind the coupling was."""
    force_n: Float64
    """Force on the hand, N, LPS axes, shape (3,)."""
    torque_n_mm: Float64
    """Torque on the hand, N mm, LPS axes, shape (3,)."""
    buttons: int
    """The device's buttons, a bit each, the first in the lowest."""
    part: float
    """Part of the force that was put out [1]: below one where the tissue's state was old."""
    energy_mj: float
    """What the hand has put in less what it got back, mJ."""
    sample_number: int
    """Number of the state of the tissue that it came from; 0 before the first."""


class Channel:
    """One device's two rings, the same in both processes.

    Parameters
    ----------
    memories
        ``memories`` of the channel in the other process; new ones when left out.
    """

    def __init__(self, memories: tuple[Any, Any] | None = None) -> None:
        if memories is None:
            memories = shared_memory(_TISSUE_ROWS, _TISSUE_WIDTH), shared_memory(_TOOL_ROWS, _TOOL_WIDTH)
        self.memories = memories
        self._tissue = Ring(memories[0], _TISSUE_ROWS, _TISSUE_WIDTH)
        self._tool = Ring(memories[1], _TOOL_ROWS, _TOOL_WIDTH)
        self._row = np.empty(_TOOL_WIDTH)

    def publish_tissue(self, sample: TissueSample) -> None:
        """Hand a state of the tissue to the loop."""
        self._tissue.write(sample.row())

    def tissue(self) -> tuple[int, TissueSample | None]:
        """Number of the newest state of the tissue, and the state; 0 and None before the first."""
        number, row = self.tissue_row()
        return number, None if row is None else TissueSample.of_row(row)

    def tissue_row(self) -> tuple[int, Float64 | None]:
        """Number of the newest state of the tissue, and the state as numbers (``TissueSample.row``), shape (21,)."""
        return self._tissue.latest() or (0, None)

    def publish_tool(
        self,
        time_s: float,
        pose: Float64,
        load: Float64,
        felt: tuple[float, float],
        buttons: tuple[bool, ...],
        sample_number: int,
    ) -> None:
        """Hand what the loop did to the simulation.

        Parameters
        ----------
        time_s
            When it was, by the clock of the loop, s.
        pose
            Where the tool is: position, LPS mm, and rotation row by row, shape (12,).
        load
            What is put out: N, N mm, shape (2, 3).
        felt
            Part of the force that is put out, and what the hand has put in less what it got back, mJ.
        buttons
            Which of the device's buttons are down.
        sample_number
            Number of the state of the tissue that the force came from; 0 before the first.
        """
        row = self._row
        row[0] = time_s
        row[1:13] = pose
        row[13:19] = load.ravel()
        row[19] = sum(1 << number for number, is_down in enumerate(buttons) if is_down)
        row[20:22] = felt
        row[22] = sample_number
        self._tool.write(row)

    def felt(self) -> Felt | None:
        """What the loop put out last; None before the first."""
        found = self._tool.latest()
        if found is None:
            return None
        row = found[1]
        return Felt(
            time_s=float(row[0]),
            pose=ToolPose(row[1:4], row[4:13].reshape(3, 3)),
            force_n=row[13:16],
            torque_n_mm=row[16:19],
            buttons=int(row[19]),
            part=float(row[20]),
            energy_mj=float(row[21]),
            sample_number=int(row[22]),
        )

    def tools(self) -> ToolHistory:
        """Where the tool was in the last half second or so."""
        # The oldest rows may be written anew while they are read.
        rows = self._tool.last(_TOOL_ROWS - 8)
        return ToolHistory(rows[:, 0], rows[:, 1:4], rows[:, 4:13].reshape(-1, 3, 3))
