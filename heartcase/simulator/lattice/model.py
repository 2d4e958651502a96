"""The cell lattice: point masses at the corners of tissue cells, joined by springs. Arrays that never change.

Every cell contributes its coverage times k/4 to each of its 12 edges and k/2 to each of its 12 face diagonals, with
k = 0.4 E h, and an eighth of its mass to each corner. The bulk is then an isotropic solid with Young's modulus
E = 2.5 k/h and Poisson's ratio 1/4, and a uniform strain is exact for any shape made of full cells.

Everything that moves is reckoned in grid units (:class:`GridUnits`): a cell's edge is one.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from heartcase.compiling.kernel import kernel
from heartcase.schemas.arrays import Bool, Float, Float32, Float64, Int8, Int32, Int64
from heartcase.schemas.bundle.lattice import (
    CELL_DIAGONALS,
    CELL_EDGES,
    CORNER_OFFSETS,
    FULL_MOMENTS,
    cell_indices,
    cell_nodes,
    lattice_keys,
)
from heartcase.schemas.errors import BundleError, Problem, SimulationError
from heartcase.schemas.geometry import Geometry
from heartcase.simulator.lattice.explicit_springs import ExplicitSprings
from heartcase.simulator.lattice.moduli import ForceLaw
from heartcase.simulator.lattice.strain_sharing import corner_shares

__all__ = ["CELL_SPRINGS", "DIRECTIONS", "GridUnits", "LatticeModel", "make_model"]


STIFFNESS_PER_MODULUS = 0.4
"""k / (E h) of the isotropic 18-neighbour lattice."""

_CELL_SPRINGS = np.concatenate([CELL_EDGES, CELL_DIAGONALS])
_CELL_SPRING_SHARE = np.repeat([1 / 4, 1 / 2], [len(CELL_EDGES), len(CELL_DIAGONALS)])
_CELL_SPRING_OFFSET = CORNER_OFFSETS[_CELL_SPRINGS[:, 1]] - CORNER_OFFSETS[_CELL_SPRINGS[:, 0]]

DIRECTIONS: Int32 = np.unique(_CELL_SPRING_OFFSET[:, ::-1], axis=0)[:, ::-1].copy()
"""The nine directions (i, j, k) of a spring from its lower to its higher node, shape (9, 3)."""

_CELL_SPRING_DIRECTION = np.array([np.flatnonzero((o == DIRECTIONS).all(axis=1))[0] for o in _CELL_SPRING_OFFSET])

CELL_SPRINGS = (_CELL_SPRINGS, _CELL_SPRING_SHARE, _CELL_SPRING_DIRECTION)
"""Lower and higher corner of a cell's 24 springs, shape (24, 2), their share of its stiffness, and their direction."""


@dataclass(frozen=True)
class GridUnits:
    """What one unit of the kernels is worth: cell edge, mass of a full cell, and the time that makes k one."""

    length_m: float
    """Edge of a cell, m."""
    mass_kg: float
    """Mass of a full cell of the densest tissue, kg."""
    time_s: float
    """sqrt(mass / k) of the stiffest tissue's lattice springs, s."""

    @property
    def force_n(self) -> float:
        """Unit of force, N."""
        return self.mass_kg * self.length_m / self.time_s**2

    @property
    def energy_j(self) -> float:
        """Unit of energy, J."""
        return self.force_n * self.length_m

    @property
    def acceleration_m_s2(self) -> float:
        """Unit of acceleration, m/s2."""
        return self.length_m / self.time_s**2


@dataclass(frozen=True)
class LatticeModel:
    """The constant arrays of a case, in grid units (cell edge, full cell's mass, k of the stiffest tissue = 1)."""

    geometry: Geometry
    """Right-handed lattice of the cells, mm; the origin is the centre of cell (0, 0, 0)."""
    units: GridUnits
    """What the grid units are worth in SI."""
    cells: Int32
    """Index (i, j, k) of each cell, shape (cell_count, 3)."""
    cell_corners: Int32
    """Node number of each cell's eight corners, shape (cell_count, 8)."""
    cell_coverage: Float32
    """Fraction of each cell that is tissue [1], shape (cell_count,)."""
    cell_stiffness: Float32
    """Young's modulus over that of the stiffest cell [1], shape (cell_count,)."""
    cell_density: Float32
    """Density over that of the densest cell [1], shape (cell_count,)."""
    cell_moments: Float32
    """Means of x, y, z, xx, yy, zz, yz, xz, xy over each cell's tissue, from its centre [edges], (cell_count, 9)."""
    cell_shares: Float32
    """Part of each cell's tissue that is strained by the mean around each corner [1], shape (cell_count, 8); zeros
    where the law does not share strain (:mod:`heartcase.simulator.lattice.strain_sharing`)."""
    cell_is_whole: Bool
    """Whether no spring of the cell was cut, shape (cell_count,). What a cut left is springs alone."""
    node_index: Int32
    """Corner (i, j, k) of each node: its rest position [cells], by k, j, i, shape (node_count, 3)."""
    node_mass: Float32
    """Mass [full cells], shape (node_count,)."""
    node_is_fixed: Bool
    """Whether a node is held for good, shape (node_count,)."""
    spring_nodes: Int32
    """Lower and higher node of each spring, shape (spring_count, 2)."""
    spring_direction: Int8
    """Number of each spring's direction in DIRECTIONS: its vector at rest [cells], shape (spring_count,)."""
    spring_weight: Float32
    """Stiffness [k], above zero, shape (spring_count,)."""
    explicit: ExplicitSprings = field(default_factory=ExplicitSprings.none)
    """Springs outside the lattice."""
    law: ForceLaw = field(default_factory=ForceLaw)
    """What resists deformation."""
    loose_count: int = 0
    """Number of nodes of no cell, which come last: a patch's (:mod:`heartcase.simulator.lattice.loose_nodes`)."""

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.node_index)

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.cells)

    @property
    def spring_count(self) -> int:
        """Number of springs."""
        return len(self.spring_nodes)

    @cached_property
    def cells_in_order(self) -> tuple[Int64, Int64]:
        """Keys of the cells, ascending, and the cell of each, shapes (cell_count,)."""
        keys = lattice_keys(self.cells)
        order = np.argsort(keys, kind="stable")
        return keys[order], order

    @cached_property
    def first_springs(self) -> Int64:
        """Springs from all lower nodes before each node, and how many there are, shape (node_count + 1,)."""
        return np.append(0, np.cumsum(np.bincount(self.spring_nodes[:, 0], minlength=self.node_count)))

    @property
    def cell_mm(self) -> float:
        """Edge of a cell, mm."""
        return self.units.length_m * 1e3

    @property
    def acting_weight(self) -> Float32:
        """Stiffness with which each spring acts under the law [k], shape (spring_count,).

        The springs of elements act in cells that were cut.
        """
        weight, scale = self.scaled_weight
        return weight * scale

    @property
    def scaled_weight(self) -> tuple[Float32, np.float32]:
        """The acting weight over a number, and that number."""
        shear = np.float32(self.law.shear_modulus)
        if not self.law.is_element:
            return self.spring_weight, shear
        if self.cell_is_whole.all():
            return np.zeros_like(self.spring_weight), shear
        cut = ~self.cell_is_whole
        stiffness = (self.cell_coverage * self.cell_stiffness)[cut].astype(float)
        weight, _ = _weights(self.cell_corners[cut], stiffness, self.node_count)
        return weight[self.spring_direction, self.spring_nodes[:, 0]].astype(np.float32), shear

    @property
    def cell_force_scale(self) -> Float32:
        """Covered stiffness of each cell that was not cut, else zero [k/h], shape (cell_count,)."""
        return np.where(self.cell_is_whole, self.cell_coverage * self.cell_stiffness, np.float32(0.0))

    @property
    def shares_strain(self) -> bool:
        """Whether some tissue is strained by the mean around a node."""
        return self.law.has_shared_strain and bool(self.cell_shares.any())

    @property
    def shared_stiffness(self) -> Float32:
        """Covered stiffness of each cell that is strained by the mean around each corner [k/h], (cell_count, 8)."""
        return self.cell_force_scale[:, None] * self.cell_shares

    @property
    def corner_guard_scale(self) -> Float32:
        """Stiffness with which corners of each cell push back [k/h], shape (cell_count,); zero in cells that were cut.

        The law's, times the cell's covered stiffness, or where that is more the least of the means over the cells
        around each of its free corners: slivers are turned back against their neighbours' springs, and as the corners'
        masses are such means too, none is the quicker for it.
        """
        own, scale = self.cell_coverage * self.cell_stiffness, np.empty(self.cell_count, np.float32)
        stiffness = float(self.law.corner_stiffness)
        _guard_scale(self.cell_corners, own, self.node_is_fixed, self.cell_is_whole, stiffness, scale)
        return scale

    @property
    def spring_offset(self) -> Int32:
        """Vector from lower to higher node at rest [cells], shape (spring_count, 3)."""
        return DIRECTIONS[self.spring_direction]

    @property
    def spring_length(self) -> Float64:
        """Rest length: 1 or sqrt(2) [cells], shape (spring_count,)."""
        length: Float64 = np.linalg.norm(DIRECTIONS, axis=1)[self.spring_direction]
        return length

    @property
    def tissue_volume_ml(self) -> float:
        """Volume of the tissue by coverage, ml."""
        return float(self.cell_coverage.sum(dtype=np.float64)) * (self.units.length_m * 100) ** 3

    @property
    def mass_kg(self) -> float:
        """Mass of all nodes, kg."""
        return float(self.node_mass.sum(dtype=np.float64)) * self.units.mass_kg

    @property
    def inverse_mass(self) -> Float32:
        """Inverse masses [1 / full cell], zero where a node is fixed, shape (node_count,)."""
        return np.where(self.node_is_fixed, np.float32(0), 1 / self.node_mass).astype(np.float32)

    def rest_positions_mm(self) -> Float64:
        """Rest positions of the nodes in patient LPS mm, shape (node_count, 3)."""
        return self.geometry.index_to_world(self.node_index - 0.5)

    def to_grid(self, vectors_mm: npt.ArrayLike) -> Float64:
        """Turn displacements in LPS mm, shape (..., 3), into grid units and axes."""
        vectors: Float64 = np.asarray(vectors_mm, dtype=float) @ self.geometry.direction_matrix / self.cell_mm
        return vectors

    def to_mm(self, vectors: Float) -> Float64:
        """Turn displacements in grid units and axes, shape (..., 3), into LPS mm."""
        world: Float64 = vectors @ (self.geometry.direction_matrix.T * self.cell_mm)
        return world

    def without_springs(self, removed: npt.ArrayLike) -> LatticeModel:
        """A copy without some springs: what a cut leaves.

        Parameters
        ----------
        removed
            True for each spring to leave out, bool, shape (spring_count,).
        """
        kept = ~np.asarray(removed, dtype=bool)
        is_cut = np.zeros((len(DIRECTIONS), self.node_count), np.bool_)
        is_cut[self.spring_direction[~kept], self.spring_nodes[~kept, 0]] = True
        is_whole = self.cell_is_whole.copy()
        for (a, _), direction in zip(_CELL_SPRINGS, _CELL_SPRING_DIRECTION, strict=True):
            is_whole &= ~is_cut[direction, self.cell_corners[:, a]]
        return replace(
            self,
            cell_is_whole=is_whole,
            spring_nodes=self.spring_nodes[kept],
            spring_direction=self.spring_direction[kept],
            spring_weight=self.spring_weight[kept],
        )

    def is_of_lattice(self, other: LatticeModel) -> bool:
        """Whether two models have the same nodes, units and law, whatever springs were cut or joined."""
        is_same = self.units == other.units and self.law == other.law
        return is_same and np.array_equal(self.node_index, other.node_index)

    def with_law(self, law: ForceLaw) -> LatticeModel:
        """A copy whose deformation another law resists."""
        shares = self.cell_shares
        if law.has_shared_strain != self.law.has_shared_strain:
            shares = _shares(law, self.cells, self.cell_corners, self.cell_coverage, self.cell_moments)
        return replace(self, law=law, cell_shares=shares)


def make_model(
    cells: npt.ArrayLike,
    *,
    coverage: npt.ArrayLike = 1.0,
    stiffness_kpa: npt.ArrayLike = 30.0,
    density_kg_m3: npt.ArrayLike = 1060.0,
    fixed: npt.ArrayLike = False,
    geometry: Geometry | None = None,
    cell_mm: float = 3.5,
    moments: npt.ArrayLike = FULL_MOMENTS,
    law: ForceLaw | None = None,
) -> LatticeModel:
    """Build the lattice of a set of cells.

    Parameters
    ----------
    cells
        Index (i, j, k) of each cell, shape (cell_count, 3), each once.
    coverage
        Fraction of the cell that is tissue, above 0 and at most 1; one number or shape (cell_count,).
    stiffness_kpa
        Young's modulus of the tissue, kPa; one number or shape (cell_count,).
    density_kg_m3
        Density of the tissue, kg/m3; one number or shape (cell_count,).
    fixed
        Whether a node is held for good; one value or shape (node_count,), nodes in the order of
        :func:`heartcase.schemas.bundle.lattice.cell_nodes`.
    geometry
        Right-handed lattice of cubic cells; cells of ``cell_mm`` along the LPS axes, with node (0, 0, 0) at the
        origin, when left out.
    cell_mm
        Edge of a cell, mm, where there is no ``geometry``.
    moments
        Means of x, y, z, xx, yy, zz, yz, xz, xy over the tissue of a cell, from its centre, in edges; shape (9,) or
        (cell_count, 9). Those of a full cell when left out: elements then take all tissue for spread over its cell.
    law
        What resists deformation; springs at a ratio of 1/4 when left out.

    Raises
    ------
    SimulationError
        The cells are not a lattice: none, one twice, a number out of range, cells that are not cubic.
    """
    try:
        cells = cell_indices(cells)
    except BundleError as error:
        raise SimulationError(error.problems) from None
    if geometry is None and not 0.0 < cell_mm < np.inf:
        raise SimulationError(f"an edge of {cell_mm:g} mm: give more than 0", place="cell_mm")
    geometry = geometry or _plain_geometry(cells, cell_mm)
    cell_count = len(cells)
    coverage = _per_cell("coverage", coverage, (cell_count,))
    youngs_modulus_pa = _per_cell("stiffness_kpa", stiffness_kpa, (cell_count,)) * 1e3
    density = _per_cell("density_kg_m3", density_kg_m3, (cell_count,))
    moments = _per_cell("moments", moments, (cell_count, len(FULL_MOMENTS))).astype(np.float32)
    _check(cells, coverage, youngs_modulus_pa, density, geometry, moments)

    nodes, corners = cell_nodes(cells)
    node_count = len(nodes)
    units = _grid_units(geometry.spacing_mm[0] * 1e-3, youngs_modulus_pa.max(), density.max())
    cell_stiffness = youngs_modulus_pa / youngs_modulus_pa.max()
    cell_density = density / density.max()

    node_mass = np.bincount(corners.ravel(), np.repeat(coverage * cell_density / 8, 8), minlength=node_count)
    springs, weight = _springs(corners, coverage * cell_stiffness, node_count)
    lower, direction, higher = springs
    law = law or ForceLaw()

    return LatticeModel(
        geometry=geometry,
        units=units,
        cells=cells,
        cell_corners=corners,
        cell_coverage=coverage.astype(np.float32),
        cell_stiffness=cell_stiffness.astype(np.float32),
        cell_density=cell_density.astype(np.float32),
        cell_moments=moments,
        cell_shares=_shares(law, cells, corners, coverage.astype(np.float32), moments),
        cell_is_whole=np.ones(cell_count, np.bool_),
        node_index=nodes,
        node_mass=node_mass.astype(np.float32),
        node_is_fixed=_fixed_nodes(fixed, node_count),
        spring_nodes=np.stack([lower, higher], axis=1).astype(np.int32),
        spring_direction=direction.astype(np.int8),
        spring_weight=weight.astype(np.float32),
        law=law,
    )


@kernel
def _guard_scale(
    corners: Int32, own: Float32, is_fixed: Bool, is_whole: Bool, stiffness: float, scale: Float32
) -> None:
    """Write a stiffness times a number of each cell or, if more, the least of the means around its free corners.

    Zero for cells that are not whole.
    """
    # Numbers without a sign are not looked at for counting from the end.
    mean, count = np.zeros(len(is_fixed)), np.zeros(len(is_fixed))
    for cell in range(len(corners)):
        for corner in range(8):
            node = np.uint32(corners[np.uint32(cell), np.uint32(corner)])
            mean[node] += own[cell]
            count[node] += 1.0
    for place in range(len(is_fixed)):
        if is_fixed[place]:
            mean[place] = np.inf
        elif mean[place] > 0.0:
            mean[place] /= count[place]
    for cell in range(len(corners)):
        least = np.inf
        for corner in range(8):
            least = min(least, mean[np.uint32(corners[np.uint32(cell), np.uint32(corner)])])
        most = max(np.float64(own[cell]), least) if least < np.inf else np.float64(own[cell])
        scale[cell] = stiffness * most if is_whole[cell] else 0.0


def _shares(law: ForceLaw, cells: Int32, corners: Int32, coverage: Float32, moments: Float32) -> Float32:
    if not law.has_shared_strain:
        return np.zeros(corners.shape, np.float32)
    return corner_shares(cells, corners, coverage, moments)


def _springs(corners: Int32, stiffness: Float64, node_count: int) -> tuple[tuple[Int64, Int64, Int32], Float64]:
    """Lower node, direction and higher node of each spring, by lower node, then direction; and its stiffness [k]."""
    weight, higher = _weights(corners, stiffness, node_count)
    by_node = weight.T.ravel()
    used = np.flatnonzero(by_node)
    lower, direction_of = np.divmod(used, len(DIRECTIONS))
    return (lower, direction_of, higher[direction_of, lower]), by_node[used]


def _weights(corners: Int32, stiffness: Float64, node_count: int) -> tuple[Float64, Int32]:
    """Stiffness [k], and higher node, of the spring from each node along each direction, shape (9, node_count)."""
    weight = np.zeros((len(DIRECTIONS), node_count))
    higher = np.zeros((len(DIRECTIONS), node_count), np.int32)
    columns = np.ascontiguousarray(corners.T)
    for (a, b), share, direction in zip(_CELL_SPRINGS, _CELL_SPRING_SHARE, _CELL_SPRING_DIRECTION, strict=True):
        weight[direction] += np.bincount(columns[a], stiffness * share, minlength=node_count)
        higher[direction, columns[a]] = columns[b]
    return weight, higher


def _grid_units(length_m: float, youngs_modulus_pa: float, density_kg_m3: float) -> GridUnits:
    stiffness_n_m = STIFFNESS_PER_MODULUS * youngs_modulus_pa * length_m
    mass_kg = density_kg_m3 * length_m**3
    return GridUnits(length_m=length_m, mass_kg=mass_kg, time_s=float(np.sqrt(mass_kg / stiffness_n_m)))


def _plain_geometry(cells: Int32, cell_mm: float) -> Geometry:
    size = np.maximum(cells.max(axis=0, initial=0) + 1, 1)
    return Geometry.of(shape=tuple(size[::-1]), origin_mm=(cell_mm / 2,) * 3, spacing_mm=(cell_mm,) * 3)


def _fixed_nodes(fixed: npt.ArrayLike, node_count: int) -> Bool:
    flags = np.asarray(fixed).astype(bool)
    if flags.ndim and flags.shape != (node_count,):
        raise SimulationError(f"fixed has {flags.size} values for {node_count} nodes: give one for each", place="fixed")
    return np.broadcast_to(flags, node_count).copy()


def _has_twins(keys: Int64) -> bool:
    """Whether a key is there twice; keys that ascend, as a bundle's do, need no sorting."""
    return bool((np.diff(keys) <= 0).any()) and len(np.unique(keys)) != len(keys)


def _per_cell(place: str, given: npt.ArrayLike, shape: tuple[int, ...]) -> Float64:
    """Numbers of each cell, of which one may stand for all."""
    try:
        return np.broadcast_to(np.asarray(given, dtype=np.float64), shape)
    except (TypeError, ValueError):
        each = f"numbers of shape {shape}" if len(shape) == 1 else f"numbers of shape {shape} or ({shape[1]},)"
        raise SimulationError(f"give one number, or {each}", place=place) from None


def _check(
    cells: Int32, coverage: Float64, modulus: Float64, density: Float64, geometry: Geometry, moments: Float32
) -> None:
    problems = []
    if not len(cells):
        problems.append(Problem("cells", "there is no tissue cell: a case needs at least one"))
    elif _has_twins(lattice_keys(cells)):
        problems.append(Problem("cells", "a cell is listed twice: give each once"))
    if not ((coverage > 0) & (coverage <= 1)).all():
        problems.append(Problem("cell_coverage", "every coverage must be above 0 and at most 1"))
    if not (np.isfinite(modulus) & (modulus > 0)).all():
        problems.append(Problem("cell_stiffness", "every Young's modulus must be above zero"))
    if not (np.isfinite(density) & (density > 0)).all():
        problems.append(Problem("cell_density", "every density must be above zero"))
    if not (np.isfinite(moments).all() and (np.abs(moments) <= 0.5).all() and (moments[:, 3:6] >= 0).all()):
        problems.append(Problem("cell_moments", "means over a cell's tissue lie within half an edge of its centre"))
    if not np.allclose(geometry.spacing_mm, geometry.spacing_mm[0], rtol=1e-5):
        problems.append(Problem("grid_geometry", "the cells must be cubic: give the same spacing along i, j and k"))
    if not geometry.is_right_handed:
        problems.append(Problem("grid_geometry", "the grid must be right-handed: flip one of its axes"))
    if problems:
        raise SimulationError(problems)
