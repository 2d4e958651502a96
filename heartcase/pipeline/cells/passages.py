"""Keeping openings open when the tissue becomes cells: septal defects, valves, vessels.

An opening is closed where blood that is connected at the samples has no way in the cells, neither straight nor the
long way round within a window. The cells with the least tissue on the way then leave the grid, unless two sides of a
wall would meet there.

The search runs on a graph. Its nodes are the pieces of void within each tissue cell (so that the two sides of a wall
inside one cell stay apart) and the void cells; its edges are sample faces that two of them share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from heartcase.compiling.kernel import kernel
from heartcase.pipeline.cells.repair import CellState, Index, index_of
from heartcase.pipeline.cells.sampling import CellSamples, VoidPieces
from heartcase.schemas.arrays import Bool, Float32, Float64, Int32, Int64
from heartcase.schemas.bundle.lattice import distinct_keys

__all__ = ["LUMEN_CELLS", "OPENING_CELLS", "blocked_openings", "closes_passage", "open_passages"]


OPENING_CELLS = 0.75
"""An opening at least this wide, in cells, is kept open."""
LUMEN_CELLS = 1.0
"""A lumen at least this wide, in cells, is kept open to its end."""

_WINDOW = 3
"""Cells around a closed opening within which another way round counts as the same opening."""
_REACH = 2
"""Blood may lie this many cells from the nearest void cell of its own; a lumen that goes on longer is opened."""
_PER_CELL = 1e-3
"""Cost of a cell on a path beside its coverage, so that of equal paths the shorter is taken."""


def open_passages(samples: CellSamples, pieces: VoidPieces, state: CellState, blood_width: Float32) -> int:
    """Open the way of blood again where cells closed an opening of at least :data:`OPENING_CELLS`.

    That is: a compartment that has no void cell at all gets one, a lumen of :data:`LUMEN_CELLS` is opened to its end,
    and cells that closed a passage leave the grid. A narrower opening may be opened too, since its width is only
    known to a sample. A cell stays where opening it would let two sides of a wall meet.

    Parameters
    ----------
    samples, pieces
        The fields in the cells and the pieces of void in each.
    state
        Changed in place.
    blood_width
        Width of the blood's way at each sample, in cells: twice the distance to the nearest tissue; 0 off the blood.

    Returns
    -------
    int
        Openings that were opened.
    """
    # A chain of samples surely runs through a canal that is wider than the threshold by a sample's diagonal.
    width = max(OPENING_CELLS - np.sqrt(3.0) / samples.factor, 0.0)

    def again(search: _Search | None = None) -> _Search:
        """A search in the cells as they are now: the last one, where it opened nothing."""
        if search is not None and not search.opened:
            return search
        return _search(samples, pieces, state, blood_width, width, may_leak=False)

    search = again()
    count = _open_lost(search, samples, blood_width)
    search = again(search)
    count += _open_ends(search, _node_width(search, blood_width) >= LUMEN_CELLS - 0.5 / samples.factor)
    search = again(search)
    return count + len(_open_ways(search))


def blocked_openings(samples: CellSamples, pieces: VoidPieces, state: CellState, blood_width: Float32) -> list[Index]:
    """A cell (k, j, i) of each opening, however narrow, that is open at the samples and closed in the cells."""
    return _open_ways(_search(samples, pieces, state.copy(), blood_width, 0.0, may_leak=True))


def closes_passage(state: CellState, cells: Sequence[Index]) -> bool:
    """Whether cells that touch each other would fill a passage of blood, or a whole piece of it, as tissue."""
    blood = [cell for cell in cells if state.is_blood[cell] and not state.tissue[cell]]
    if not blood:
        return False
    tissue = state.tissue.copy()
    for cell in cells:
        tissue[cell] = True
    free = np.pad(state.is_blood & ~tissue, 1)
    rim = sorted(
        {
            (k + a, j + b, i + c)
            for k, j, i in blood
            for a, b, c in ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))
            if free[k + a + 1, j + b + 1, i + c + 1]
        }
    )
    if not rim:
        return True
    return not all(_connected_nearby(tissue, state.is_blood, *rim[0], *other, _WINDOW) for other in rim[1:])


@dataclass(frozen=True)
class _Graph:
    """Void pieces of tissue cells, and void cells, that touch."""

    node_cell: Int64
    """Flat cell of each graph node, ascending."""
    node_piece: Int64
    """Piece of the cell."""
    node: Int32
    """Graph node at each sample; -1 where there is none."""
    contacts: Int64
    """Touching nodes, shape (n, 2), lower first."""
    ways: Int64
    """The contacts that blood of enough width passes."""


@dataclass
class _Search:
    """A graph, and what is opened along it."""

    graph: _Graph
    state: CellState
    tissue: Bool
    """Nodes in tissue cells."""
    blood: Bool
    """Nodes that are void cells of blood."""
    usable: Bool
    """Nodes that a way may lead through."""
    ways: Int64
    """The graph's ways between usable nodes."""
    cost: Float64
    """Cost of opening each node's cell."""
    cells: Int64
    """Index (k, j, i) of each node's cell."""
    may_leak: bool
    """Whether opened cells may lack a contact with each other."""
    opened: dict[Index, int]
    """Node of each cell that was opened."""

    @cached_property
    def touching(self) -> set[tuple[int, int]]:
        """Contacts that opened cells must have with each other."""
        return {(int(a), int(b)) for a, b in self.graph.contacts}

    def open(self, path: list[int]) -> Index | None:
        """Open the cells of a path unless that leaks; returns the fullest of them."""
        if not self.may_leak and not self._fits(path):
            return None
        fresh = [node for node in path if self.state.tissue[index_of(self.cells[node])]]
        for node in fresh:
            cell = index_of(self.cells[node])
            self.state.open(cell, int(self.graph.node_piece[node]))
            self.opened[cell] = node
        return index_of(self.cells[max(fresh, key=lambda node: (self.cost[node], -node))]) if fresh else None

    def _fits(self, path: list[int]) -> bool:
        trial = dict(self.opened)
        if any(trial.setdefault(index_of(self.cells[node]), node) != node for node in path):
            return False
        for node in path:
            k, j, i = index_of(self.cells[node])
            for cell in ((k - 1, j, i), (k + 1, j, i), (k, j - 1, i), (k, j + 1, i), (k, j, i - 1), (k, j, i + 1)):
                other = trial.get(cell)
                if other is not None and (min(node, other), max(node, other)) not in self.touching:
                    return False
        return True


def _search(
    samples: CellSamples,
    pieces: VoidPieces,
    state: CellState,
    blood_width: Float32,
    width: float,
    *,
    may_leak: bool,
) -> _Search:
    graph = _graph(samples, pieces, state, blood_width, width)
    tissue = state.tissue.ravel()[graph.node_cell]
    blood = ~tissue & state.is_blood.ravel()[graph.node_cell]
    usable = tissue | blood
    if not may_leak:
        usable &= ~_leaky(graph, state)
    return _Search(
        graph=graph,
        state=state,
        tissue=tissue,
        blood=blood,
        usable=usable,
        ways=graph.ways[usable[graph.ways].all(axis=1)],
        cost=_PER_CELL + samples.coverage.ravel()[graph.node_cell].astype(np.float64),
        cells=np.stack(np.unravel_index(graph.node_cell, state.tissue.shape), axis=1),
        may_leak=may_leak,
        opened={},
    )


def _open_lost(search: _Search, samples: CellSamples, blood_width: Float32) -> int:
    """Open a cell of each compartment of at least a cell's volume that has no void cell."""
    count = len(search.cost)
    at = search.graph.node[(blood_width > 0.0) & (search.graph.node >= 0)]
    volume = np.bincount(at, minlength=count) / samples.factor**3
    links = sparse.csr_matrix((np.ones(len(search.ways)), search.ways.T), shape=(count, count))
    group = csgraph.connected_components(links, directed=False)[1]
    of_group = np.bincount(group, volume * search.usable)
    has_void = np.zeros(len(of_group), np.bool_)
    has_void[group[search.blood]] = True
    opened = 0
    for lost in np.flatnonzero((of_group >= 1.0) & ~has_void):
        members = np.flatnonzero((group == lost) & search.usable & (volume > 0.0))
        for node in members[np.argsort(search.cost[members], kind="stable")]:
            if search.open([int(node)]) is not None:
                opened += 1
                break
    return opened


def _node_width(search: _Search, blood_width: Float32) -> Float32:
    """Greatest width of the blood in each node."""
    at = search.graph.node >= 0
    width = np.zeros(len(search.cost), np.float32)
    np.maximum.at(width, search.graph.node[at], blood_width[at])
    return width


def _open_ends(search: _Search, is_lumen: Bool) -> int:
    """Open lumens on to their ends, the farthest end first."""
    if len(search.ways) == 0:
        return 0
    sources = np.flatnonzero(search.blood)
    given_up = np.zeros(len(search.cost), np.bool_)
    opened = 0
    while len(sources):
        closed = search.tissue.copy()
        closed[sources] = False
        steps = _from_void(search.ways, np.ones(len(closed)), sources, closed)[0]
        steps[~np.isfinite(steps) | given_up | ~is_lumen] = 0.0
        ends = np.flatnonzero(steps > _REACH)
        if len(ends) == 0:
            return opened
        _, before, source = _from_void(search.ways, search.cost, sources, closed)
        # What is opened from one void cell hardly changes the way to an end that is nearest to another.
        ends = ends[np.lexsort((ends, -steps[ends]))]
        ends = ends[np.sort(np.unique(source[ends], return_index=True)[1])]
        for end in ends:
            path = _trace(before, int(end), closed)
            if search.open(path) is None:
                given_up[end] = True
                continue
            opened += 1
            sources = np.union1d(sources, path)
    return opened


def _open_ways(search: _Search) -> list[Index]:
    """Open the cheapest ways between void cells that have no way round; returns the fullest cell of each."""
    sources = np.flatnonzero(search.blood)
    if len(sources) == 0 or len(search.ways) == 0:
        return []
    state, cells = search.state, search.cells
    distance, before, source = _from_void(search.ways, search.cost, sources, search.tissue)
    a, b = search.ways[:, 0], search.ways[:, 1]
    rival = np.isfinite(distance[a]) & np.isfinite(distance[b]) & (source[a] != source[b])
    a, b = a[rival], b[rival]
    middle: list[Index] = []
    # cells only become void here, so what is joined stays joined
    joined: set[tuple[int, int]] = set()
    for n in np.lexsort((b, a, distance[a] + distance[b])):
        pair = int(source[a[n]]), int(source[b[n]])
        if pair in joined:
            continue
        if _connected_nearby(state.tissue, state.is_blood, *cells[pair[0]], *cells[pair[1]], _WINDOW):
            joined.add(pair)
            continue
        fullest = search.open(_trace(before, int(a[n]), search.tissue) + _trace(before, int(b[n]), search.tissue))
        if fullest is not None:
            middle.append(fullest)
    return middle


def _trace(before: Int64, node: int, tissue: Bool) -> list[int]:
    path = []
    while node >= 0 and tissue[node]:
        path.append(node)
        node = int(before[node])
    return path


def _graph(samples: CellSamples, pieces: VoidPieces, state: CellState, blood_width: Float32, width: float) -> _Graph:
    count = np.where(state.tissue, pieces.count, pieces.count > 0).astype(np.int64).ravel()
    base = np.concatenate(([0], np.cumsum(count)))
    node_cell = np.repeat(np.arange(count.size), count)
    rank = np.arange(base[-1]) - base[node_cell]
    node_piece = np.where(state.tissue.ravel()[node_cell], rank + 1, state.main.ravel()[node_cell])
    node = np.full(pieces.piece.shape, -1, np.int32)
    _number_samples(pieces.piece, state.main, state.tissue, base, samples.factor, node)
    wide = (blood_width > 0.0) & (blood_width >= width)
    s = samples.factor
    contacts, ways = [], []
    for axis in range(3):
        low = tuple(slice(s - 1, -1, s) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(s, None, s) if a == axis else slice(None) for a in range(3))
        a, b = node[low].ravel().astype(np.int64), node[high].ravel().astype(np.int64)
        passes = (wide[low] & wide[high]).ravel()
        both = (a >= 0) & (b >= 0)
        a, b, passes = a[both], b[both], passes[both]
        mixed = state.tissue.ravel()[node_cell[a]] | state.tissue.ravel()[node_cell[b]]
        a, b, passes = a[mixed], b[mixed], passes[mixed]
        contacts.append(a << 32 | b)
        ways.append((a << 32 | b)[passes])
    return _Graph(node_cell, node_piece, node, _unpacked(contacts), _unpacked(ways))


def _unpacked(keys: list[Int64]) -> Int64:
    unique = distinct_keys(np.concatenate(keys))
    return np.stack((unique >> 32, unique & 0xFFFFFFFF), axis=1)


def _leaky(graph: _Graph, state: CellState) -> Bool:
    """Nodes of tissue cells that cannot be opened: a void cell beside them does not meet their void."""
    holds = ~state.tissue & (state.main > 0)
    beside = np.zeros(state.tissue.shape, np.int64)
    for axis in range(3):
        low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        beside[low] += holds[high]
        beside[high] += holds[low]
    void_node = holds.ravel()[graph.node_cell]
    met = np.zeros(len(void_node), np.int64)
    for one, two in ((0, 1), (1, 0)):
        np.add.at(met, graph.contacts[void_node[graph.contacts[:, two]], one], 1)
    leaky: Bool = ~void_node & (met < beside.ravel()[graph.node_cell])
    return leaky


def _from_void(ways: Int64, cost: Float64, sources: Int64, tissue: Bool) -> tuple[Float64, Int64, Int64]:
    """Cheapest cost from a void cell to every node through tissue cells, the node before it and the void cell."""
    to = np.concatenate((ways[:, 1], ways[:, 0]))
    of = np.concatenate((ways[:, 0], ways[:, 1]))
    inward = tissue[to]
    graph = sparse.csr_matrix((cost[to[inward]], (of[inward], to[inward])), shape=(len(cost), len(cost)))
    distance, before, source = csgraph.dijkstra(graph, indices=sources, min_only=True, return_predecessors=True)
    return distance, before.astype(np.int64), source.astype(np.int64)


@kernel
def _number_samples(piece, main, tissue, base, s, node):
    nk, nj, ni = tissue.shape
    for k in range(nk):
        for j in range(nj):
            for i in range(ni):
                first = base[(k * nj + j) * ni + i]
                if base[(k * nj + j) * ni + i + 1] == first:
                    continue
                for z in range(k * s, k * s + s):
                    for y in range(j * s, j * s + s):
                        for x in range(i * s, i * s + s):
                            number = np.int64(piece[z, y, x])
                            if number == 0:
                                continue
                            if tissue[k, j, i]:
                                node[z, y, x] = first + number - 1
                            elif number == main[k, j, i]:
                                node[z, y, x] = first


@kernel
def _connected_nearby(tissue, is_blood, k0, j0, i0, k1, j1, i1, margin):
    """Whether blood cells join two blood cells inside their common box, grown by a margin."""
    nk, nj, ni = tissue.shape
    lk, hk = max(min(k0, k1) - margin, 0), min(max(k0, k1) + margin, nk - 1)
    lj, hj = max(min(j0, j1) - margin, 0), min(max(j0, j1) + margin, nj - 1)
    li, hi = max(min(i0, i1) - margin, 0), min(max(i0, i1) + margin, ni - 1)
    wj, wi = hj - lj + 1, hi - li + 1
    seen = np.zeros((hk - lk + 1) * wj * wi, np.bool_)
    stack = np.empty(seen.size, np.int64)
    stack[0] = ((k0 - lk) * wj + j0 - lj) * wi + i0 - li
    seen[stack[0]] = True
    top = 1
    while top > 0:
        top -= 1
        at = stack[top]
        k, j, i = at // (wj * wi) + lk, at // wi % wj + lj, at % wi + li
        if k == k1 and j == j1 and i == i1:
            return True
        for step in range(6):
            move = 1 if step % 2 else -1
            a, b, c = k, j, i
            if step < 2:
                a += move
            elif step < 4:
                b += move
            else:
                c += move
            if a < lk or a > hk or b < lj or b > hj or c < li or c > hi:
                continue
            if tissue[a, b, c] or not is_blood[a, b, c]:
                continue
            n = ((a - lk) * wj + b - lj) * wi + c - li
            if not seen[n]:
                seen[n] = True
                stack[top] = n
                top += 1
    return False
