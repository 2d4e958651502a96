"""Shaping a recipe, as a page drives it: what is there, acts on it, and proposals from the labels as they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from heartcase.pipeline.building.first_look import first_look
from heartcase.pipeline.building.quick_surface import QuickSurface, quick_surface
from heartcase.pipeline.building.recipe_history import RecipeHistory
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.edits.septum_place import septum_place
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.vessel_ends.discs import Stumps, end_marker
from heartcase.pipeline.vessel_ends.end_place import end_place
from heartcase.pipeline.vessel_ends.find_ends import find_ends
from heartcase.pipeline.walls.grow_walls import resolve_walls
from heartcase.schemas.errors import UsageError
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.recipe import Recipe, parse_recipe
from heartcase.studio.shaping.acts import done_to, plain
from heartcase.studio.shaping.facts import LINES, SETTINGS
from heartcase.studio.shaping.label_table import check_names
from heartcase.studio.shaping.requests import Act, AddLabel, Propose, RemoveLabel

__all__ = ["Shaping"]


class Shaping:
    """What a recipe says beside its strokes.

    Parameters
    ----------
    history
        The recipe's text and the acts on it.
    session
        The labels as they are painted now.
    check_table
        Raises where marker files mean something else by another table.
    """

    def __init__(
        self, history: RecipeHistory, session: SegmentationSession, check_table: Callable[[LabelTable], None]
    ) -> None:
        self._history = history
        self._session = session
        self._check_table = check_table

    def shape(self) -> dict[str, Any]:
        """What the recipe says now, as plain data."""
        recipe = self._history.recipe
        table = recipe.table
        devices = sorted({edit.label for edit in recipe.edits if edit.kind == "close_defect"} - _names(recipe))
        return {
            "name": recipe.name,
            "lines": {name: [plain(line) for line in _at(recipe, name)] for name in LINES},
            "settings": {
                name: {key: value for key, value in plain(_at(recipe, name)).items() if key in keys}
                for name, (_, keys) in SETTINGS.items()
            },
            "walls": [
                {
                    "label": label.name,
                    "term": label.term.name if label.term else None,
                    "wall_thickness_mm": label.wall_thickness_mm,
                    "has_table": any(table.find(one.label) == label for one in recipe.walls.thickness),
                }
                for label in table
                if label.role.is_blood
            ],
            "materials": {name: plain(one) for name, one in recipe.materials.labels.items()},
            "structures": [
                {
                    "name": label.name,
                    "role": label.role.value,
                    "colour": label.colour,
                    "is_grown": label.value not in table,
                    "term": label.term.name if label.term else None,
                }
                for label in table.with_walls()
            ]
            + [
                {"name": name, "role": "device", "colour": "#a0a0a0", "is_grown": False, "term": None}
                for name in devices
            ],
            "is_locked": recipe.lock is not None,
        }

    def act(self, request: Act) -> None:
        """Carry an act out.

        Raises
        ------
        HeartcaseError
            It cannot be done, and nothing has changed.
        """
        history = self._history
        if isinstance(request, RemoveLabel):
            self._check_unpainted(request.label)
        head, kind = done_to(history.head, history.recipe, request)
        if isinstance(request, AddLabel | RemoveLabel):
            check_names(head, self._session.strokes, history.recipe.table)
            self._check_table(parse_recipe(head, needs_markers=False).table)
        history.change(kind, head)
        # what was painted and taken back before cannot be done again behind this
        self._session.offer_again(())

    def _check_unpainted(self, name: str) -> None:
        session = self._session
        label = session.table.find(name)
        if label is None:
            return
        painted = [session.table.find(stroke.label) for stroke in session.strokes if stroke.label is not None]
        if label in painted or label.value in session.marked_values():
            raise UsageError(
                f"{label.name!r} is painted: take its strokes back first, with undo", place=f"labels.{label.name}"
            )

    def propose(self, request: Propose) -> dict[str, Any]:
        """How a disc lies at a place.

        Raises
        ------
        HeartcaseError
            Nothing is painted, or there is nothing to propose at the place.
        """
        segmentation, recipe = self._session.segmentation(), self._history.recipe
        table = recipe.table.with_walls()
        if request.about == "vessel":
            stumps = _stumps(recipe, segmentation)
            end = end_place(segmentation, table, stumps, request.position_mm, request.label)
            return plain(end)
        place = septum_place(segmentation, table, request.position_mm)
        return {
            "position_mm": _rounded(place.position_mm, 1),
            "axis": _rounded(place.axis, 3),
            "thickness_mm": round(place.thickness_mm, 1),
            "between": place.between,
        }

    def find_ends(self) -> Callable[[], dict[str, Any]]:
        """What finds the ends that the recipe does not cut yet, in the labels as they are now.

        Raises
        ------
        HeartcaseError
            Nothing is painted.
        """
        # a copy: painting goes on meanwhile
        segmentation, recipe = self._session.segmentation(), self._history.recipe

        def find() -> dict[str, Any]:
            stumps = _stumps(recipe, segmentation)
            found = find_ends(segmentation, recipe.table.with_walls(), stumps, known=recipe.ends)
            return {
                "ends": [plain(end_marker(end)) for end in found.ends if not end.is_open],
                "open": sorted({end.label for end in found.ends if end.is_open}),
                "dropped": found.dropped,
            }

        return find

    def preview(self, *, is_coarse: bool = False) -> Callable[[], QuickSurface]:
        """What makes the surface of the labels and the recipe as they are now.

        Parameters
        ----------
        is_coarse
            Whether it should come sooner rather than finely.

        Raises
        ------
        HeartcaseError
            Nothing is painted.
        """
        session, recipe = self._session, self._history.recipe
        strokes = session.strokes
        segmentation = first_look(session, recipe) if is_coarse else session.segmentation()
        return lambda: quick_surface(segmentation, recipe, strokes, is_coarse=is_coarse)


def _stumps(recipe: Recipe, segmentation: Segmentation) -> Stumps:
    geometry = segmentation.geometry
    walls = resolve_walls(recipe.walls, geometry, recipe.table)
    return Stumps.of(walls, recipe.table.with_walls(), geometry.spacing_mm)


def _at(recipe: Recipe, name: str) -> Any:
    found: Any = recipe
    for key in name.split("."):
        found = getattr(found, key)
    return found


def _names(recipe: Recipe) -> set[str]:
    return {label.name for label in recipe.table.with_walls()}


def _rounded(vector: tuple[float, ...], digits: int) -> list[float]:
    return [round(one, digits) + 0.0 for one in vector]
