"""A segmentation that answers while it is painted: strokes, erasing, undo and redo on a scan's basin tree."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from heartcase.pipeline.data import UNMARKED, Markers, Scan, Segmentation
from heartcase.pipeline.markers.load_markers import rasterise_strokes, stroke_voxels
from heartcase.pipeline.markers.locks import Locks
from heartcase.pipeline.markers.marker_help import ERASED, AutomaticMarkers
from heartcase.pipeline.markers.stroke_notes import StrokeNotes
from heartcase.pipeline.watershed.boxes import Box, around_both, voxels_at
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.loading import load_stroke_kernels
from heartcase.pipeline.watershed.sight import Sight, plane_in_sight
from heartcase.pipeline.watershed.tree import BasinTree
from heartcase.schemas.arrays import Bool, Float64, Int64, UInt8
from heartcase.schemas.errors import MarkerError, UsageError, problems_from_validation
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.settings import SegmentSettings, Stroke

if TYPE_CHECKING:
    from heartcase.pipeline.markers.states import StillSegmentation
    from heartcase.pipeline.markers.suggest import RightPlace, StrokePlaces

__all__ = ["SegmentationSession"]

AXES = ("i", "j", "k")


class SegmentationSession:
    """What a viewer drives: it paints, and shows the labels of the whole watershed at once.

    At any time the labels are those that the watershed gives for the markers there are then, voxel for voxel
    (:mod:`heartcase.pipeline.watershed`), as if nothing had been painted before and taken back.

    Parameters
    ----------
    tree
        The tree of the smoothed scan's gradient: see :func:`heartcase.pipeline.watershed.tree_cache.scan_tree`.
    geometry
        The scan's lattice.
    table
        What may be painted.
    markers
        What is marked at the start; nothing when left out. With automatic markers among them, these follow what is
        painted: see :class:`heartcase.pipeline.markers.marker_help.AutomaticMarkers`.
    whole
        Lattice of the whole scan, where ``geometry`` is that of its region of interest.

    Raises
    ------
    MarkerError
        The markers lie on another lattice, or mark values that are not in the table.
    """

    def __init__(
        self,
        tree: BasinTree,
        geometry: Geometry,
        table: LabelTable,
        *,
        markers: Markers | AutomaticMarkers | None = None,
        whole: Geometry | None = None,
    ) -> None:
        if tree.height.shape != geometry.shape:
            raise UsageError("the tree was made on another scan", place="session")
        self._automatic = markers if isinstance(markers, AutomaticMarkers) else None
        if isinstance(markers, AutomaticMarkers):
            markers = markers.markers
        painted = np.full(geometry.shape, UNMARKED, np.uint8) if markers is None else markers.labels
        if markers is not None:
            if not markers.geometry.matches(geometry):
                raise MarkerError("the markers lie on another lattice than the scan", place="markers")
            unknown = set(np.unique(painted).tolist()) - {*table.values, UNMARKED}
            if unknown:
                listed = ", ".join(str(value) for value in sorted(unknown))
                raise MarkerError(f"value {listed} is not in the label table", place="markers")
        self.geometry = geometry
        self.table = table
        self._whole = whole or geometry
        self._forest = solve_forest(tree, painted)
        self._strokes: list[Stroke] = []
        self._notes = StrokeNotes()
        self._undone: list[Stroke] = []
        self._changed: Box | None = None
        self._locks = Locks((), self._forest.labels)
        self.right_places: tuple[RightPlace, ...] = ()
        # the lists that a first stroke would otherwise wait for
        _ = tree.voxels, tree.neighbours, tree.hanging

    @classmethod
    def of_scan(
        cls,
        filtered: Scan,
        table: LabelTable,
        *,
        markers: Markers | AutomaticMarkers | None = None,
        settings: SegmentSettings | None = None,
    ) -> SegmentationSession:
        """A session on a smoothed scan, without a cache.

        Parameters
        ----------
        filtered
            The smoothed scan: see :func:`heartcase.pipeline.image.filter_scan.filter_scan`.
        table
            What may be painted.
        markers
            What is marked at the start; nothing when left out.
        settings
            Scales of gradient and shape, and noise floor; those of the scan's kind when left out.
        """
        from heartcase.pipeline.watershed.tree_cache import scan_tree

        tree = scan_tree(filtered, settings or SegmentSettings())
        return cls(tree, filtered.geometry, table, markers=markers)

    def put_off(self) -> None:
        """Leave labels of many voxels for later, from now on: what is seen first can be asked for first.

        Where a stroke changes many, :meth:`paint`, :meth:`extend`, :meth:`undo` and :meth:`redo` return None, and
        :attr:`put_off_tiles` says where labels may have changed. Nothing that is asked for is ever of before:
        :meth:`labels_of_boxes` works out what it needs, and all else works out the rest first. But where a large flat
        minimum is being divided among several labels, what is settled or asked for *so far* has the labels that are
        known yet (:attr:`is_dividing`).
        """
        load_stroke_kernels()
        middle = self.geometry.index_to_world(0.5 * np.array([self.geometry.size]))
        stroke_voxels(
            Stroke(erase=True, radius_mm=min(self.geometry.spacing_mm), points_mm=middle.tolist()), self.geometry
        )
        self._forest.puts_off = True
        self._forest.get_ready()

    def catch_up(self) -> bool:
        """Work out, of what is put off, some of what the next stroke needs, a few ms long; whether there was any."""
        if self._forest.is_dividing:
            self._note(None)
        return self._forest.fill_some()

    @property
    def is_settled(self) -> bool:
        """Whether the labels of all voxels are worked out."""
        return self._forest.is_settled

    @property
    def is_dividing(self) -> bool:
        """Whether flat minima are being divided, piece by piece with :meth:`catch_up`; tiles with them get put off."""
        return self._forest.is_dividing

    @property
    def put_off_tiles(self) -> Bool:
        """Tiles of 32 voxels along each side with labels that are put off, bool, shape [z, y, x] of tiles; a copy."""
        return self._forest.put_off.copy()

    @property
    def put_off_times(self) -> int:
        """How often labels were put off so far."""
        return self._forest.put_off_times

    @property
    def tile_stamps(self) -> Int64:
        """By tile: higher, the later it was that a label which was put off turned out to be another one; a copy."""
        return self._forest.stamps.copy()

    def in_sight(self, normal: Float64, offset: float) -> Sight:
        """The voxels whose cubes the plane ``normal @ (i, j, k) == offset`` meets, listed for :meth:`settle_sight`."""
        return plane_in_sight(self._forest.tree, normal, offset)

    def settle_sight(self, sight: Sight) -> None:
        """Work out the labels that are put off of what a plane shows: :attr:`tile_stamps` says where they changed."""
        self._forest.settle_sight(sight)

    def settle_boxes(self, boxes: Sequence[Box]) -> None:
        """Work out labels that are put off in some boxes, those that are known so far."""
        self._forest.settle_boxes(boxes)

    def labels_of_boxes(self, boxes: Sequence[Box]) -> list[UInt8]:
        """Labels in some boxes of slices [z, y, x], copies. Flats are divided for it; what else is put off stays so.

        Parameters
        ----------
        boxes
            Within the scan. A tile is not put off any more where one of them is all of it.
        """
        self._finish_dividing()
        self._forest.settle_boxes(boxes)
        return [self._forest.labels[box].copy() for box in boxes]

    def thinned_labels(self, box: Box) -> UInt8:
        """Labels so far of every n-th voxel along each axis in slices [z, y, x] with steps: a copy, and not settled."""
        self._forest.settle_voxels(voxels_at(box, self.geometry.shape))
        return np.ascontiguousarray(self._forest.labels[box])

    def labels_so_far(self, boxes: Sequence[Box]) -> list[UInt8]:
        """Labels in some boxes, copies; what is put off there is of some earlier moment."""
        return [self._forest.labels[box].copy() for box in boxes]

    def volumes_ml(self) -> Float64:
        """Volume of each label value, ml, shape (256,). Flats are divided for it; labels that are put off stay so."""
        self._finish_dividing()
        return self._forest.label_counts().astype(np.float64) * (self.geometry.voxel_volume_mm3 / 1000.0)

    def marked_values(self) -> frozenset[int]:
        """Values of the labels that any voxel is marked with."""
        return frozenset(np.flatnonzero(self._forest.painted_counts()).tolist()) - {UNMARKED}

    def paint(self, stroke: Stroke, *, may_miss: bool = False) -> Box | None:
        """Mark, or erase, along a stroke.

        Parameters
        ----------
        stroke
            The brush's radius and its line; a label of the table, or ``erase``.
        may_miss
            Whether it may lie outside the region of interest, in the scan: then it marks nothing, as in a build. For
            strokes of an earlier session; whoever paints wants to be told.

        Returns
        -------
        tuple of slices or None
            The box [z, y, x] in which labels changed; None where none did.

        Raises
        ------
        MarkerError
            The label is not in the table, the stroke lies outside the scan, or it would change a locked structure.
            Nothing is changed then.
        """
        box = self._carry_out(stroke, may_miss=may_miss)
        self._undone.clear()
        return box

    def extend(self, points_mm: Sequence[Sequence[float]]) -> Box | None:
        """Go on with the last stroke, from its last point to these: as if it had been painted in one.

        Parameters
        ----------
        points_mm
            LPS mm, shape (n, 3); at least one.

        Returns
        -------
        tuple of slices or None
            The box [z, y, x] in which labels changed; None where none did.

        Raises
        ------
        UsageError
            There is no stroke of this session, or one was taken back since.
        MarkerError
            A point is not three finite numbers, there is none, or a locked structure would change. Nothing is changed
            then.
        """
        if not self._strokes or self._undone:
            raise UsageError("there is no stroke to go on with: begin one", place="extend")
        last = self._strokes[-1]
        stated = last.model_dump(exclude={"points_mm"})
        try:
            piece = Stroke.model_validate(stated | {"points_mm": (last.points_mm[-1], *points_mm)})
            whole = Stroke.model_validate(stated | {"points_mm": (*last.points_mm, *points_mm)})
        except ValidationError as error:
            raise MarkerError(problems_from_validation(error, place="stroke")) from None
        if len(piece.points_mm) == 1:
            raise MarkerError("give at least one point", place="stroke.points_mm")
        voxels, value, marked = self._reached(piece)
        # What the stroke went over before holds its value, and what was there before it is noted.
        voxels = voxels[marked.ravel()[voxels] != value]
        before = marked.ravel()[voxels]
        box = self._mark(voxels, np.full(len(voxels), value, np.uint8))
        self._check_locks(value, box, voxels, before)
        self._strokes[-1] = whole
        self._notes.extend(voxels, before)
        return self._note(box)

    def undo(self) -> Box | None:
        """Take the last stroke back; the box in which labels changed.

        Raises
        ------
        UsageError
            There is no stroke of this session to take back.
        """
        if not self._strokes:
            raise UsageError("there is no stroke to take back", place="undo")
        self._undone.append(self._strokes.pop())
        return self._note(self._mark(*self._notes.pop()))

    def redo(self) -> Box | None:
        """Paint the stroke again that was taken back last; the box in which labels changed.

        Raises
        ------
        UsageError
            Nothing was taken back since the last stroke.
        """
        if not self._undone:
            raise UsageError("there is no stroke to paint again", place="redo")
        box = self._carry_out(self._undone[-1], minds_locks=False, may_miss=True)
        self._undone.pop()
        return box

    @property
    def labels(self) -> UInt8:
        """Label of every voxel, uint8, shape [z, y, x], read-only; 255 everywhere while nothing is marked.

        It is the same array always, so what is read from it later is what holds then; or, after :meth:`put_off`, what
        held when this was asked last.
        """
        self._finish_dividing()
        self._forest.settle()
        view = self._forest.labels.view()
        view.flags.writeable = False
        return view

    def labels_of_slice(self, axis: str, index: int) -> UInt8:
        """Labels of one slice at right angles to the scan's axis ``i``, ``j`` or ``k``: a copy, two-dimensional.

        Parameters
        ----------
        axis
            ``i``, ``j`` or ``k``.
        index
            Number of the slice along it, from 0.

        Raises
        ------
        UsageError
            There is no such axis or slice.
        """
        if axis not in AXES:
            raise UsageError(f"there is no axis {axis!r}: i, j or k", place="axis")
        place = 2 - AXES.index(axis)
        if not 0 <= index < self._forest.labels.shape[place]:
            raise UsageError(f"there is no slice {index} along {axis}: 0 to {self._forest.labels.shape[place] - 1}")
        k, j, i = (
            slice(index, index + 1) if axis == place else slice(0, n)
            for axis, n in enumerate(self._forest.labels.shape)
        )
        return self.labels_of_box((k, j, i)).squeeze(place)

    def labels_of_box(self, box: Box) -> UInt8:
        """Labels in a box of slices [z, y, x]: a copy."""
        return self.labels_of_boxes([box])[0]

    def take_changed(self) -> Box | None:
        """The box of all changes since this was asked last; None where nothing changed.

        After :meth:`put_off` it is the whole scan where anything was put off meanwhile.
        """
        box, self._changed = self._changed, None
        return box

    @property
    def strokes(self) -> tuple[Stroke, ...]:
        """The strokes of this session that hold, in order: what goes into the recipe."""
        return tuple(self._strokes)

    @property
    def redo_count(self) -> int:
        """Number of strokes that :meth:`redo` can paint again."""
        return len(self._undone)

    @property
    def undone(self) -> tuple[Stroke, ...]:
        """The strokes that :meth:`redo` can paint again, the next one last."""
        return tuple(self._undone)

    def offer_again(self, strokes: Iterable[Stroke]) -> None:
        """Let :meth:`redo` paint these strokes, the last one first: what an earlier session took back."""
        self._undone = list(strokes)

    @property
    def locked(self) -> frozenset[int]:
        """Values of the labels that are locked."""
        return self._locks.values

    def lock(self, values: Collection[int]) -> None:
        """Lock these labels, and no others: none of their voxels is lost, and none is won, by strokes of other labels.

        A stroke, or a part of one, that would change one of them is refused. What the structure itself is painted with
        may change it, and taking back and painting again always does what it did.

        Parameters
        ----------
        values
            Values of labels of the table.

        Raises
        ------
        UsageError
            One is not in the table.
        """
        unknown = sorted(set(values) - set(self.table.values))
        if unknown:
            raise UsageError(f"value {unknown[0]} is not in the label table", place="lock")
        self._locks = Locks(values, self.labels)

    def use_table(self, table: LabelTable) -> None:
        """Paint with another table from now on; locks and right places of labels that it lacks are forgotten.

        Raises
        ------
        UsageError
            Something is marked that it lacks.
        """
        missing = sorted(self.marked_values() - set(table.values))
        if missing:
            raise UsageError(f"value {missing[0]} is painted and not in the label table", place="labels")
        self.table = table
        self.right_places = tuple(one for one in self.right_places if one.label in table and one.rival in table)
        if not self.locked <= set(table.values):
            self.lock(self.locked & set(table.values))

    def still(self) -> StillSegmentation:
        """The segmentation as it is now, copied: it can be looked at in another thread while painting goes on."""
        from heartcase.pipeline.markers.states import StillSegmentation

        self._finish_dividing()
        return StillSegmentation(self._forest.copy(), self.geometry, self.table, self.right_places)

    @property
    def marked(self) -> UInt8:
        """Label value that each voxel is marked with, uint8, shape [z, y, x], read-only; UNMARKED where none is."""
        view = self._forest.painted.view()
        view.flags.writeable = False
        return view

    def markers(self) -> Markers:
        """All markers as they are now: a copy."""
        return Markers(self._forest.painted.copy(), self.geometry)

    def segmentation(self) -> Segmentation:
        """The labels as they are now: a copy.

        Raises
        ------
        MarkerError
            Nothing is marked.
        """
        self._check_that_anything_is_marked()
        return Segmentation(self.labels.copy(), self.geometry, self.table)

    def suggest(self, *, count: int = 5) -> StrokePlaces:
        """Where one more stroke would change most: see :func:`heartcase.pipeline.markers.suggest.suggest_strokes`.

        Parameters
        ----------
        count
            Number of places, at most.

        Raises
        ------
        MarkerError
            Nothing is marked.
        """
        from heartcase.pipeline.markers.suggest import suggest_strokes

        self._check_that_anything_is_marked()
        self._finish_dividing()
        self._forest.settle()
        return suggest_strokes(self._forest, self.geometry, count=count, right=self.right_places)

    def _finish_dividing(self) -> None:
        """Divide flats to the end: labels change by that."""
        if self._forest.is_dividing:
            self._note(None)
            self._forest.finish_dividing()

    def _check_that_anything_is_marked(self) -> None:
        if not self._forest.is_labelled:
            raise MarkerError("no voxel of the scan is marked: paint first", place="markers")

    def _carry_out(self, stroke: Stroke, *, minds_locks: bool = True, may_miss: bool) -> Box | None:
        voxels, value, marked = self._reached(stroke)
        if not len(voxels) and not (may_miss and len(stroke_voxels(stroke, self._whole))):
            # the same words as for a recipe's stroke
            rasterise_strokes((stroke,), self.table, self.geometry)
        before = marked.ravel()[voxels]
        box = self._mark(voxels, np.full(len(voxels), value, np.uint8))
        if minds_locks:
            self._check_locks(value, box, voxels, before)
        self._strokes.append(stroke)
        self._notes.push(voxels, before)
        return self._note(box)

    def _reached(self, stroke: Stroke) -> tuple[Int64, int, UInt8]:
        """Voxels under a stroke, the value that it gives them, and what is stated of all voxels now."""
        label = None if stroke.label is None else self.table.find(stroke.label)
        if stroke.label is not None and label is None:
            rasterise_strokes((stroke,), self.table, self.geometry)
        marked = self._forest.painted if self._automatic is None else self._automatic.stated
        erased = UNMARKED if self._automatic is None else ERASED
        return stroke_voxels(stroke, self.geometry), erased if label is None else label.value, marked

    def _mark(self, voxels: Int64, values: UInt8) -> Box | None:
        """Mark voxels, and what automatic markers follow from that; a box around the labels that changed."""
        if self._automatic is not None and len(voxels):
            voxels, values = self._automatic.paint(voxels, values)
        box = self._forest.restore(voxels, values)
        if self._locks.values and (self._forest.is_dividing or self._forest.put_off.any()):
            # locks look at every voxel
            self._forest.settle()
            k, j, i = (slice(0, n) for n in self._forest.labels.shape)
            box = k, j, i
        return box

    def _check_locks(self, value: int, box: Box | None, voxels: Int64, before: UInt8) -> None:
        """Take marks back that change a structure which is locked, and say which."""
        changed = self._locks.changed_by(value, self._forest.labels, box) if self._locks.values else {}
        if not changed:
            return
        self._mark(voxels, before)
        ml = self.geometry.voxel_volume_mm3 / 1000.0
        listed = ", ".join(f"{self.table[one].name} ({count * ml:.3g} ml)" for one, count in changed.items())
        raise MarkerError(
            f"this would change what is locked: {listed}; unlock it, or paint further away from it", place="stroke"
        )

    def _note(self, box: Box | None) -> Box | None:
        if self._locks.values:
            self._locks.hold(self._forest.labels, box)
        changed = box
        if self._forest.is_dividing or self._forest.put_off.any():
            # what is put off is not known to have stayed
            k, j, i = (slice(0, n) for n in self._forest.labels.shape)
            changed = k, j, i
        self._changed = around_both(self._changed, changed)
        return box
