"""The retractor: a grab along a line on one lip of an incision, padded so that it does not tear.

Each node that it holds hangs on its blade by a pad: the node gives way to the tissue's pull by pull over stiffness, and
without end where the pull would pass a limit, which is the same for all nodes. So no place carries much more than
another. A blade that held its nodes rigidly would carry most of the load at its ends, whatever its mean is.

The pads have no mass. How the tissue pulls at the beginning of a row of steps tells how far they give way in it, in
straight lines: towards where pads and pull are in balance, and no further than is safe. For that all pads together move
against what the tissue around them may resist, and each by itself against what it may there. By neither the balance is
overshot to more than as far again, as a cell resists no movement of its corners by more than its omega^2 at most times
their masses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from heartcase.schemas.arrays import Float, Float32, Float64, Int64, Intp
from heartcase.schemas.errors import Problem, SimulationError
from heartcase.simulator.instruments.grab import Grab, Pose
from heartcase.simulator.instruments.held_tissue import (
    is_across,
    nodes_reached,
    on_own_side,
    tissue_at_rest,
    tissue_now,
)
from heartcase.simulator.instruments.one_sided import OneSidedGrab
from heartcase.simulator.instruments.placing import is_point, point_in_lattice
from heartcase.simulator.lattice.model import LatticeModel

__all__ = ["LIMIT_N_MM", "STIFFNESS_N_MM2", "Retractor", "close_retractor"]

STIFFNESS_N_MM2 = 0.2
"""Stiffness of the pads where nothing else is said: N for each mm along the line and each mm that they give."""
LIMIT_N_MM = 0.5
"""Pull along the line that a retractor does not keep up where nothing else is said, N/mm. A choice, not a measurement:
half of some 1 N/mm: 4.8 N, the least mean force that tears out a stitch (Medicina 2022, 58, 1055), each 5 mm."""
_BIN = 1.0
"""Length along the line over which a pull is told [cells]."""
_SETTLE = 2e-3
"""Time in which a pad settles, s."""


@dataclass(eq=False)
class Retractor(OneSidedGrab):
    """Nodes along a line on one lip, on pads, which are led."""

    along: Float64 = field(default_factory=lambda: np.zeros(0))
    """Place of each node along the line [cells], shape (count,)."""
    length: float = 1.0
    """Length of the line [cells]."""
    stiffness: float = 1.0
    """Stiffness of all pads together [grid units]."""
    limit: float = np.inf
    """Pull of all pads together that they do not pass [grid units]."""
    resistance: tuple[float, float] = (0.0, 0.0)
    """Most stiffness with which tissue may resist a movement of all nodes alike, for each, and of one by itself [k]."""
    settle: float = 0.0
    """Time in which a pad settles [units of time]."""
    give: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    """How far each pad has given way [cells, grid axes], shape (count, 3)."""
    row_share: float = 1.0
    """Part of a row of steps that the next steps are."""
    _give_next: Float64 | None = None

    def pads(self) -> Float64:
        """Force of each pad on its node [grid units], shape (count, 3)."""
        force = -self.stiffness / len(self.nodes) * self.give
        size = np.linalg.norm(force, axis=1, keepdims=True)
        most = self.limit / len(self.nodes)
        # Where there is no limit nothing is cut down: infinity over a small number is none.
        share: Float64 = np.divide(most, size, out=np.ones_like(size), where=size > most)
        return force * share

    def displacement_at(self, pose: Pose) -> Float64:
        """Displacements of the nodes at a pose, with what the pads give now [cells, grid axes], shape (count, 3)."""
        return super().displacement_at(pose) + self.give

    def way(self, forces: Callable[[Intp], Float32], duration: float) -> tuple[Float64, Float64]:
        """Displacements of the nodes at the start and at the end of the next steps [cells], (count, 3) each.

        Parameters
        ----------
        forces
            Gives the force of the tissue on some nodes now [grid units], shape (count, 3).
        duration
            Time that the steps take [grid units].
        """
        whole = duration / self.row_share
        left_over = forces(self.nodes).astype(float) + self.pads()
        settled = -np.expm1(-whole / self.settle) if self.settle > 0.0 else 1.0
        together, alone = (self.stiffness / len(self.nodes) + resistance for resistance in self.resistance)
        mean = left_over.mean(axis=0)
        step = settled * (mean / together + (left_over - mean) / alone)
        self._give_next = self.give + self.row_share * step
        end = super().displacement_at(self.target) + self._give_next
        return self.displacement_at(self.pose), end

    def arrive(self) -> None:
        """The steps were taken: it is where it was led to, and the pads have given way."""
        super().arrive()
        if self._give_next is not None:
            self.give = self._give_next
        self._give_next, self.row_share = None, 1.0

    def stay(self) -> None:
        """The steps were not taken: it is led nowhere."""
        super().stay()
        self._give_next, self.row_share = None, 1.0

    def lead_part(self, share: float) -> None:
        """Lead it so far towards where it is led, and let pads give way so far; in a straight line."""
        super().lead_part(share)
        # At none it only halts: the next row is a whole one.
        self.row_share = share or 1.0

    def carry(self, nodes: Intp, place: Int64) -> None:
        """Hold other nodes from now on: those of a lattice that was cut further, each from the one at ``place``."""
        super().carry(nodes, place)
        self.along, self.give = self.along[place], self.give[place]

    def keep_side(self, model: LatticeModel, sheets: Float64) -> None:
        """Let go of what a further cut put onto the other side of it; the pads stand on what is left.

        Parameters
        ----------
        model
            The lattice after the cut.
        sheets
            Triangles of all that was cut, at rest [cells, frame of the nodes], shape (triangle_count, 3, 3).
        """
        super().keep_side(model, sheets)
        self.resistance = _resistance(model, self.nodes)

    def arms_now(self) -> Float64:
        """Vectors from the hand's centre to where its nodes are now [cells, grid axes], shape (count, 3)."""
        return super().arms_now() + self.give

    def pull_along(self, pull: Float) -> Float64:
        """Pull of the tissue along the line, in bins of about a cell [grid units a cell], shape (bin_count,).

        Parameters
        ----------
        pull
            Force of the tissue on each node [grid units], shape (count, 3).
        """
        count = max(1, round(self.length / _BIN))
        bins = np.minimum((self.along / self.length * count).astype(int), count - 1)
        sums = np.stack([np.bincount(bins, pull[:, axis], minlength=count) for axis in range(3)], axis=1)
        along: Float64 = np.linalg.norm(sums, axis=1) / (self.length / count)
        return along


def close_retractor(
    model: LatticeModel,
    displacement: Float32,
    line_mm: npt.ArrayLike,
    side: npt.ArrayLike,
    *,
    depth_mm: float,
    stiffness_n_mm2: float,
    limit_n_mm: float | None,
    sheets: Float64,
    others: Sequence[Grab] = (),
    name: str = "retractor",
) -> Retractor:
    """A retractor that takes hold along a line on one lip.

    Held are nodes of cells whose tissue has its middle within the depth of the line, that can be reached along springs
    from the tissue beside the line on the side given, and that belong to no tissue on the other side of an incision.
    Nodes that another hand holds stay with it.

    Parameters
    ----------
    model
        The lattice.
    displacement
        Displacement of the nodes [cells, grid axes], shape (node_count, 3).
    line_mm
        The line along the lip, LPS mm, shape (point_count, 3), at least two points.
    side
        From the line into the tissue that it shall hold, LPS, shape (3,), of any length: tells one lip from the other.
    depth_mm
        How far from the line it holds, mm; above 0. Less than a cell counts as a cell.
    stiffness_n_mm2
        Stiffness of the pads: N for each mm along the line and each mm that they give; above 0.
    limit_n_mm
        Pull along the line that the pads do not keep up, N/mm, above 0; none when left out. Pulled more, as while it is
        led, they give way to it within some tenths of a second.
    sheets
        Triangles of all that was cut, at rest [cells, frame of the nodes], shape (triangle_count, 3, 3).
    others
        Hands that hold already.
    name
        Name in messages.

    Raises
    ------
    SimulationError
        There is no tissue on that side of the line that can be held, or with everything that is wrong in what was
        given.
    """
    line = _line(model, line_mm)
    numbers = {"depth": depth_mm, "stiffness": stiffness_n_mm2, "limit": np.inf if limit_n_mm is None else limit_n_mm}
    problems = [
        Problem(name, f"the {what} must be above 0 (found {number:g})")
        for what, number in numbers.items()
        if not number > 0.0 or (what != "limit" and not np.isfinite(number))
    ]
    if line is None:
        problems.append(Problem(name, "the line needs two points or more, of three finite numbers, not all the same"))
    if not is_point(side) or not np.asarray(side, dtype=float).any():
        problems.append(Problem(name, "the side must be three finite numbers, not all zero"))
    if problems or line is None:
        raise SimulationError(problems)
    into = model.to_grid(side)
    into = into / np.linalg.norm(into)
    depth = max(depth_mm / model.cell_mm, 1.0)

    now, rest = tissue_now(model, displacement), tissue_at_rest(model)
    distance, beside, along = _from_line(line, now)
    near = np.flatnonzero((distance <= depth) & ((now - beside) @ into > -0.5))
    is_beyond = (now[near] - beside[near]) @ into > 0.0
    starts = _starts(line, now[near[is_beyond]], into, depth)
    if not len(starts):
        raise SimulationError(
            f"there is no tissue within {depth_mm:.3g} mm of the line on that side: move the line there, or turn the "
            "side round",
            place=name,
        )
    starts = near[is_beyond][starts]
    # Each cell is held from the tissue beside the line that is nearest to it.
    own = starts[np.abs(along[near][:, None] - along[starts]).argmin(axis=1)]
    is_own = ~is_across(sheets, rest[own], rest[near])
    near, own = near[is_own], own[is_own]
    nodes = nodes_reached(model, near, starts)
    nodes = nodes[~model.node_is_fixed[nodes]]
    _, _, node_along = _from_line(line, (model.node_index[nodes] + displacement[nodes]).astype(float))
    roots = rest[starts[np.abs(node_along[:, None] - along[starts]).argmin(axis=1)]] if len(nodes) else rest[:0]
    kept = on_own_side(model, sheets, nodes, roots)
    for other in others:
        kept &= ~np.isin(nodes, other.nodes)
    nodes, roots, node_along = nodes[kept], roots[kept], node_along[kept]
    if not len(nodes):
        raise SimulationError("all the tissue beside the line is fixed or held: take hold elsewhere", place=name)
    closed_at = displacement[nodes]
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    force_unit = model.units.force_n
    return Retractor(
        nodes=nodes,
        closed_at=closed_at,
        arms=model.node_index[nodes] + closed_at - line.mean(axis=0),
        name=name,
        roots=roots,
        along=node_along,
        length=length,
        stiffness=stiffness_n_mm2 * (length * model.cell_mm) * model.cell_mm / force_unit,
        limit=numbers["limit"] * length * model.cell_mm / force_unit,
        resistance=_resistance(model, nodes),
        settle=_SETTLE / model.units.time_s,
        give=np.zeros((len(nodes), 3)),
    )


def _line(model: LatticeModel, line_mm: npt.ArrayLike) -> Float64 | None:
    """Points of a line in the frame of the nodes [cells]; None where they make none."""
    try:
        points = np.asarray(line_mm, dtype=float)
    except (TypeError, ValueError):
        return None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all():
        return None
    line = np.stack([point_in_lattice(model, point) for point in points])
    return line if np.diff(line, axis=0).any() else None


def _from_line(line: Float64, points: Float64) -> tuple[Float64, Float64, Float64]:
    """Distance of points from a line, the place on it that is nearest to each, and how far along that lies [cells]."""
    distance, along = np.full(len(points), np.inf), np.zeros(len(points))
    nearest = np.zeros_like(points)
    before = 0.0
    for start, end in pairwise(line):
        way = end - start
        length = float(np.linalg.norm(way))
        if length == 0.0:
            continue
        share = np.clip((points - start) @ way / length**2, 0.0, 1.0)
        place = start + share[:, None] * way
        apart = np.linalg.norm(points - place, axis=1)
        closer = apart < distance
        distance = np.where(closer, apart, distance)
        nearest[closer] = place[closer]
        along = np.where(closer, before + share * length, along)
        before += length
    return distance, nearest, along


def _starts(line: Float64, tissue: Float64, into: Float64, depth: float) -> Intp:
    """Which tissue lies beside the line: for each half cell of it, what is nearest to a place a little way in."""
    if not len(tissue):
        return np.zeros(0, dtype=np.intp)
    found = set()
    for start, end in pairwise(line):
        for share in np.linspace(0.0, 1.0, max(2, int(np.ceil(2.0 * np.linalg.norm(end - start))) + 1)):
            place = start + share * (end - start) + 0.5 * into
            apart = np.linalg.norm(tissue - place, axis=1)
            if apart.min() <= depth:
                found.add(int(apart.argmin()))
    return np.array(sorted(found), dtype=np.intp)


def _resistance(model: LatticeModel, nodes: Intp) -> tuple[float, float]:
    """The most that tissue may resist a movement of all of some nodes alike, for each, and of one by itself [k]."""
    # A cell resists no more than omega^2 of a lone cell times its corners' masses, an eighth of it each; where some
    # corners move alike it resists as if the others moved the other way.
    most = model.law.stretched_bound / 8.0 * model.cell_coverage.astype(float) * model.cell_stiffness
    is_held = np.zeros(model.node_count, dtype=bool)
    is_held[nodes] = True
    held = is_held[model.cell_corners].sum(axis=1)
    together = float(most @ np.minimum(held, 8 - held)) / len(nodes)
    around = np.bincount(model.cell_corners.ravel(), np.repeat(most, 8), minlength=model.node_count)
    return together, float(around[nodes].max())
