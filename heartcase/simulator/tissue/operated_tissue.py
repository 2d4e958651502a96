"""Tissue that is operated on with forceps, retractors and scissors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import SimulationError
from heartcase.simulator.cutting.blade_sheet import Poses
from heartcase.simulator.cutting.crossings import QUANTA
from heartcase.simulator.instruments.forceps import Forceps, close_forceps
from heartcase.simulator.instruments.grab import Grab
from heartcase.simulator.instruments.retractor import LIMIT_N_MM, STIFFNESS_N_MM2, Retractor, close_retractor
from heartcase.simulator.instruments.scissors import Scissors, bring_scissors
from heartcase.simulator.tissue.moving_tissue import MovingTissue

__all__ = ["OperatedTissue"]


class OperatedTissue(MovingTissue):
    """Tissue in motion, and instruments with two jaws or a blade that hold or cut it; see :class:`Simulation`."""

    grabs: list[Grab]
    """Hands, forceps and retractors that hold tissue."""
    open_scissors: list[Scissors]
    """Scissors beside or in the tissue."""

    def forceps(
        self,
        tip_mm: npt.ArrayLike,
        direction: npt.ArrayLike,
        closing: npt.ArrayLike,
        *,
        length_mm: float = 10.0,
        width_mm: float = 4.0,
        opening_mm: float = 8.0,
        gap_mm: float | None = None,
        name: str = "forceps",
    ) -> Forceps:
        """Take hold, with forceps, of the tissue between their jaws; they close with the end of the next :meth:`step`.

        Held is what can be reached along springs between the jaws on one side of all incisions. It is led and let go
        as what a hand holds: :meth:`lead`, :meth:`release`.

        Parameters
        ----------
        tip_mm
            Middle between the tips of the jaws, LPS mm, shape (3,).
        direction
            Along the jaws towards the tips, LPS, shape (3,), of any length.
        closing
            From one jaw to the other, LPS, shape (3,), of any length.
        length_mm, width_mm
            Length and width of the jaws, mm.
        opening_mm
            Gap between the open jaws, mm.
        gap_mm
            Gap to which they close; they only touch the tissue when left out.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            There is no tissue between the jaws that can be held, or with everything that is wrong in what was given.
        """
        closed = close_forceps(
            self.model,
            self.state.displacement,
            tip_mm,
            direction,
            closing,
            length_mm=length_mm,
            width_mm=width_mm,
            opening_mm=opening_mm,
            sheets=self._sheet_triangles(),
            others=self.grabs,
            name=name,
        )
        closed.squeeze_to(closed.thickness if gap_mm is None else self._gap(gap_mm, name))
        self.grabs.append(closed)
        self._hold()
        return closed

    def squeeze(self, forceps: Forceps, gap_mm: float) -> None:
        """Close, or open, the jaws of forceps to a gap, mm; they arrive with the end of the next :meth:`step`.

        Tissue is squeezed to a quarter of its thickness at most. Open jaws hold on until they are let go.

        Raises
        ------
        SimulationError
            They are no forceps, or have let go, or the gap is not above 0.
        """
        if not isinstance(forceps, Forceps) or forceps not in self.grabs:
            raise SimulationError("no forceps of this kind hold tissue: close them first", place="forceps")
        forceps.squeeze_to(self._gap(gap_mm, forceps.name))

    def pinch_force_n(self, forceps: Forceps) -> float:
        """Force with which the tissue presses each jaw of forceps away from the other, N; 0 once they have let go."""
        if forceps not in self.grabs:
            return 0.0
        return forceps.pinch(self._engine.forces(forceps.nodes)) * float(self.model.units.force_n)

    def retractor(
        self,
        line_mm: npt.ArrayLike,
        side: npt.ArrayLike,
        *,
        depth_mm: float = 6.0,
        stiffness_n_mm2: float = STIFFNESS_N_MM2,
        limit_n_mm: float | None = LIMIT_N_MM,
        name: str = "retractor",
    ) -> Retractor:
        """Take hold of one lip of an incision along a line, with pads that spread the load.

        It is led and let go as what a hand holds: :meth:`lead`, :meth:`release`.

        Parameters
        ----------
        line_mm
            The line along the lip, LPS mm, shape (point_count, 3), at least two points.
        side
            From the line into the tissue that it shall hold, LPS, shape (3,), of any length.
        depth_mm
            How far from the line it holds, mm; less than a cell counts as a cell.
        stiffness_n_mm2
            Stiffness of the pads: N for each mm along the line and each mm that they give.
        limit_n_mm
            Pull along the line at which the pads give way without end, N/mm; None for none. Pulled more, as while it is
        led, they come back to it within some tenths of a second.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            There is no tissue on that side that can be held, or with everything that is wrong in what was given.
        """
        closed = close_retractor(
            self.model,
            self.state.displacement,
            line_mm,
            side,
            depth_mm=depth_mm,
            stiffness_n_mm2=stiffness_n_mm2,
            limit_n_mm=limit_n_mm,
            sheets=self._sheet_triangles(),
            others=self.grabs,
            name=name,
        )
        self.grabs.append(closed)
        self._hold()
        return closed

    def retraction_n_mm(self, retractor: Retractor) -> Float64:
        """Pull of the tissue along a retractor's line, N/mm, for each cell of it or so, shape (any,); 0 once let go."""
        if retractor not in self.grabs:
            return np.zeros_like(retractor.pull_along(np.zeros((len(retractor.nodes), 3))))
        per_cell = retractor.pull_along(self._engine.forces(retractor.nodes).astype(float))
        return per_cell * (self.model.units.force_n / self.model.cell_mm)

    def scissors(
        self,
        hinge_mm: npt.ArrayLike,
        direction: npt.ArrayLike,
        closing: npt.ArrayLike,
        *,
        length_mm: float = 20.0,
        opening_deg: float = 40.0,
        name: str = "scissors",
    ) -> Scissors:
        """Bring in fully open scissors. They touch nothing; :meth:`snip` cuts what lies between their jaws.

        Parameters
        ----------
        hinge_mm
            Where the jaws are joined, LPS mm, shape (3,).
        direction
            From the hinge towards the tips of the closed jaws, LPS, shape (3,), of any length.
        closing
            From one jaw to the other, LPS, shape (3,), of any length.
        length_mm
            Length of the jaws from the hinge, mm.
        opening_deg
            Angle between the fully open jaws, degrees; at most 90.
        name
            Name in messages.

        Raises
        ------
        SimulationError
            With everything that is wrong in what was given.
        """
        brought = bring_scissors(
            self.model, hinge_mm, direction, closing, length_mm=length_mm, opening_deg=opening_deg, name=name
        )
        self.open_scissors.append(brought)
        return brought

    def place_scissors(
        self, scissors: Scissors, hinge_mm: npt.ArrayLike, direction: npt.ArrayLike, closing: npt.ArrayLike
    ) -> None:
        """Put scissors elsewhere, as of :meth:`scissors`; they keep their angle and touch nothing on the way.

        Raises
        ------
        SimulationError
            They were withdrawn, or with everything that is wrong in what was given.
        """
        self._require_scissors(scissors)
        scissors.place(self.model, hinge_mm, direction, closing)

    def snip(self, scissors: Scissors, angle_deg: float = 0.0, *, rest_poses_mm: Poses | None = None) -> None:
        """Close the jaws to an angle: what lies between them is cut, from the hinge on as far as they have met.

        To a larger angle than now they open, and cut nothing. Closing from fully open to 0 cuts along all their length.

        Parameters
        ----------
        scissors
            The scissors.
        angle_deg
            Angle between the jaws, degrees: 0 to their opening.
        rest_poses_mm
            Where the cut meets the tissue at rest, as :meth:`snip_poses_mm` gave it; worked out when left out.

        Raises
        ------
        SimulationError
            They were withdrawn, the angle is out of range, or the tissue cannot be cut (:meth:`cut`).
        """
        poses = self.snip_poses_mm(scissors, angle_deg) if rest_poses_mm is None else rest_poses_mm
        self._require_scissors(scissors)
        if poses is not None:
            self.cut(poses, at_rest=True, name=scissors.name)
        scissors.angle = float(np.radians(angle_deg))

    def snip_poses_mm(self, scissors: Scissors, angle_deg: float) -> Float64 | None:
        """Poses of a blade, at rest, that cuts what :meth:`snip` would, LPS mm, (any, any, 3); None for no cut.

        Raises
        ------
        SimulationError
            They were withdrawn, or the angle is out of range.
        """
        self._require_scissors(scissors)
        if not 0.0 <= angle_deg <= np.degrees(scissors.opening) + 1e-9:
            most = np.degrees(scissors.opening)
            raise SimulationError(f"the jaws close to 0 and open to {most:g} degrees", place=scissors.name)
        sheet = scissors.sheet(float(np.radians(angle_deg)))
        if sheet is None:
            return None
        poses_mm = self.model.geometry.index_to_world(sheet.reshape(-1, 3) - 0.5).reshape(sheet.shape)
        return self.rest_poses_mm(poses_mm, name=scissors.name)

    def withdraw_scissors(self, scissors: Scissors) -> None:
        """Take scissors away. Those that were withdrawn already stay so."""
        if scissors in self.open_scissors:
            self.open_scissors.remove(scissors)

    def _hold(self) -> None:
        """Let the engine know what is held."""
        raise NotImplementedError

    def _require_scissors(self, scissors: Scissors) -> None:
        if scissors not in self.open_scissors:
            raise SimulationError("no such scissors are here: bring them in first", place="scissors")

    def _gap(self, gap_mm: float, name: str) -> float:
        if not 0.0 < gap_mm < np.inf:
            raise SimulationError(f"the gap between the jaws must be above 0 mm (found {gap_mm:g})", place=name)
        return gap_mm / self.model.cell_mm

    def _sheet_triangles(self) -> Float64:
        """Triangles of all that was cut, at rest [cells, frame of the nodes], shape (triangle_count, 3, 3)."""
        sheets = () if self.cuts is None else self.cuts.sheets
        return np.concatenate([np.zeros((0, 3, 3)), *(sheet.triangles / QUANTA for sheet in sheets)])
