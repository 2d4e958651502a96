"""A recipe as pages drive it: strokes that grow, shaping, all saved as it happens and taken back in its order."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.library.scans import ensure_scan, scan_is_made
from heartcase.pipeline.building.quick_surface import QuickSurface
from heartcase.pipeline.building.recipe_history import STROKE, RecipeHistory, open_history
from heartcase.pipeline.building.recipe_text import changed_text, place_words
from heartcase.pipeline.building.runner import BuildListener
from heartcase.pipeline.building.session_file import RecipeSession, open_session
from heartcase.pipeline.data import UNMARKED, Scan
from heartcase.pipeline.markers.states import StillSegmentation
from heartcase.pipeline.watershed.boxes import Box
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import BACKGROUND, LabelTable, Role
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from heartcase.schemas.toml_places import Place
from heartcase.studio.messages import boxes_message, labels_message, scan_message, surface_message, text_message
from heartcase.studio.painting.drafts import Draft
from heartcase.studio.painting.locks import keep_locks, lock_again, lock_label
from heartcase.studio.painting.place_picture import place_picture
from heartcase.studio.painting.planes import planes_message
from heartcase.studio.painting.requests import (
    Confirm,
    End,
    Extend,
    History,
    Lock,
    Look,
    Paint,
    Picture,
    Planes,
    Request,
    Rest,
    Suggest,
)
from heartcase.studio.painting.right_places import confirm_again, confirm_place, keep_places
from heartcase.studio.painting.shown import Shown, planes_in_voxels
from heartcase.studio.shaping.facts import shaping_facts
from heartcase.studio.shaping.requests import (
    Add,
    AddLabel,
    Change,
    FindEnds,
    Preview,
    Propose,
    Remove,
    RemoveLabel,
    Set,
)
from heartcase.studio.shaping.shaping import Shaping

__all__ = ["Answer", "Painting", "open_painting"]

Lattices = tuple[LabelTable, Geometry, Geometry | None]
"""Labels, the lattice that is painted on, and that of the whole scan where it is another."""

_SHOWN_EVERY_S = 0.04
"""While flat minima are divided, what is in sight is shown so often."""
_CT_WINDOW = (-150.0, 450.0)
"""Contrast-filled chambers, muscle and fat, HU."""
_ATRIA = ("82471001", "73829009")
"""SNOMED CT codes of the two that are often painted as one."""
_WINDOW_PERCENTILES = (1.0, 99.5)


@dataclass(frozen=True)
class Answer:
    """What comes of a request."""

    for_all: tuple[str | bytes, ...] = ()
    """Messages for every page on the recipe, in this order."""
    done: str | None = None
    """For the page that asked, after these."""
    later: Callable[[], tuple[str | bytes, ...]] | None = None
    """What takes long and looks at nothing that changes: it may run beside other requests, and gives what is told to
    the page that asked."""
    for_each: Mapping[object, tuple[bytes, ...]] = field(default_factory=dict)
    """Messages for some pages alone, before those for all."""


class Painting:
    """A recipe that is being painted on and shaped.

    Parameters
    ----------
    opened
        The recipe, and the session on its scan.
    history
        Its text, and what was done to it.
    locks
        File that remembers what is locked.
    """

    def __init__(self, opened: RecipeSession, history: RecipeHistory, locks: Path) -> None:
        self._opened = opened
        self._history = history
        self._shaping = Shaping(history, opened.session, opened.check_table)
        self._drawn_by: object | None = None
        self._locks = locks
        self._shown: dict[object, Shown] = {}
        self._tells_volumes = False
        opened.session.put_off()
        self._right = locks.with_name(locks.name.replace(".locks.", ".right."))
        lock_again(opened.session, locks)
        confirm_again(opened.session, self._right)

    @property
    def is_stale(self) -> bool:
        """Whether another program changed the recipe since it was read or written here."""
        return self._history.is_stale

    @property
    def is_saved(self) -> bool:
        """Whether the recipe has every stroke."""
        return len(self._opened.session.strokes) == self._history.stroke_count

    def greeting(self) -> tuple[str | bytes, ...]:
        """All that a page needs to show the recipe as it is now."""
        opened, session = self._opened, self._opened.session
        scan, geometry = opened.scan, session.geometry
        low, high = _window(scan)
        facts = text_message(
            "opened",
            name=self._history.recipe.name,
            size=geometry.size,
            spacing_mm=geometry.spacing_mm,
            index_to_world=geometry.affine.tolist(),
            modality=scan.modality if scan.modality in ("CT", "MR") else None,
            labels=_label_rows(session.table),
            unmarked=UNMARKED,
            window={"low": low, "high": high},
            range={"low": float(scan.values.min()), "high": float(scan.values.max())},
            **self._counts(),
        )
        everything = (slice(0, n) for n in geometry.shape)
        k, j, i = everything
        labels = labels_message(session.labels, (k, j, i))
        return (
            facts,
            text_message("shaping_facts", **shaping_facts()),
            self._shape(),
            scan_message(scan),
            labels,
            self._structures(),
        )

    def do(self, request: Request, page: object, pages: Collection[object] = ()) -> Answer:
        """Carry a request out.

        Parameters
        ----------
        request
            What is asked.
        page
            Who asks: a stroke goes on for the page that began it.
        pages
            All that look at the recipe.

        Raises
        ------
        HeartcaseError
            It cannot be done, and nothing has changed; or a stroke was painted and could not be saved.
        """
        session = self._opened.session
        match request:
            case Paint():
                self._close_stroke()
                box = session.paint(request.stroke)
                self._drawn_by = page
                return self._painted(request, box, pages)
            case Extend():
                if self._drawn_by is not page:
                    raise UsageError("there is no stroke to go on with: begin one", place="extend")
                return self._painted(request, session.extend(request.points_mm), pages)
            case End():
                if self._drawn_by is page:
                    self._close_stroke()
                return self._told(request, self._structures())
            case History():
                self._close_stroke()
                return self._step(request, pages)
            case Add() | Change() | Remove() | Set() | AddLabel() | RemoveLabel():
                self._close_stroke()
                self._shaping.act(request)
                return self._told(request, *self._shaped())
            case Propose():
                return Answer(done=text_message("proposal", id=request.id, **self._shaping.propose(request)))
            case FindEnds():
                find = self._shaping.find_ends()
                return Answer(later=lambda: (text_message("found_ends", id=request.id, **find()),))
            case Preview():
                return Answer(later=_preview(request, self._shaping.preview(is_coarse=request.coarse)))
            case Suggest():
                found = session.suggest(count=request.count).as_json(session.table)
                return Answer(done=text_message("places", id=request.id, **found))
            case Confirm():
                confirm_place(session, request.position_mm, request.label, request.rival, file=self._right)
                return Answer(done=self._done(request))
            case Lock():
                self._close_stroke()
                lock_label(session, request.label, is_locked=request.locked, file=self._locks)
                return self._told(request, self._structures())
            case Picture():
                scan = self._opened.scan
                url = place_picture(scan, session.labels, session.table, request.position_mm, _window(scan))
                return Answer(done=text_message("picture", id=request.id, url=url))
            case Look():
                shown = self._shown.setdefault(page, Shown(session))
                shown.look(planes_in_voxels(request.planes, session.geometry))
                return Answer(for_each={page: shown.in_sight()}, done=self._seen(request, shown))
            case Rest():
                shown = self._shown.setdefault(page, Shown(session))
                return self._rest(request, page, shown)
            case Planes():
                return Answer(done=planes_message(request.id, session, self._history.recipe.landmarks))

    def _rest(self, request: Rest, page: object, shown: Shown) -> Answer:
        """Some of what has still to come: one thing at a time, as a stroke may be waiting."""
        session = self._opened.session
        was_dividing = session.is_dividing
        messages: tuple[bytes, ...] = ()
        if not session.catch_up():
            messages = shown.rest()
        elif was_dividing:
            for one in self._shown.values():
                one.note(session.put_off_tiles)
            # what is between is for the eye alone
            if not session.is_dividing or shown.seconds_since_seen > _SHOWN_EVERY_S:
                messages = shown.in_sight()
        told: tuple[str, ...] = ()
        if self._tells_volumes and session.is_settled:
            self._tells_volumes = False
            told = (text_message("volumes", volumes_ml=self._volumes_ml()),)
        return Answer(told, self._seen(request, shown), for_each={page: messages})

    @property
    def is_outdated(self) -> bool:
        """Whether the recipe names other marker files than those that are painted on: it must be opened again."""
        return self._history.recipe.markers != self._opened.recipe.markers

    @property
    def lattices(self) -> Lattices:
        """What a draft must go with."""
        session = self._opened.session
        return session.table, session.geometry, self._opened.whole

    def add(self, draft: Draft, ready: Path) -> None:
        """Write a draft as one more marker file of the recipe.

        Parameters
        ----------
        draft
            The draft.
        ready
            Its file or folder, checked against :attr:`lattices`.

        Raises
        ------
        HeartcaseError
            It does not go with the recipe, and nothing has changed.
        """
        self._close_stroke()
        history, directory = self._history, self._history.path.parent
        place: Place = ("markers", len(history.recipe.markers))
        name = draft.added_to(directory, ready)
        try:
            history.change(place_words(place), changed_text(history.head, (place, draft.marker_file(name))))
        except BaseException:
            # what the recipe does not name goes with what is discarded
            (directory / name).rename(ready)
            raise

    @property
    def is_dividing(self) -> bool:
        """Whether labels still spread."""
        return self._opened.session.is_dividing

    def still(self) -> StillSegmentation:
        """A copy of the segmentation, to be looked at while painting goes on."""
        return self._opened.session.still()

    def leave(self, page: object, *, is_last: bool) -> tuple[str, ...]:
        """Whoever drew is gone: the stroke ends where it is; messages for the pages that are left.

        When the last one goes, a stroke that could not be saved before is saved.
        """
        self._shown.pop(page, None)
        return self.save() if self._drawn_by is page or is_last else ()

    def save(self) -> tuple[str, ...]:
        """Save a stroke that is not saved yet; messages for all pages."""
        if self.is_saved:
            return ()
        self._close_stroke()
        return self._structures(), self._done()

    def _step(self, request: History, pages: Collection[object]) -> Answer:
        """Take the last act back, or do the next one again."""
        session, history = self._opened.session, self._history
        act = history.undo() if request.do == "undo" else history.redo()
        if act.kind != STROKE:
            return self._told(request, *self._shaped())
        answer = self._painted(request, session.undo() if request.do == "undo" else session.redo(), pages)
        return replace(answer, for_all=(*answer.for_all, self._structures()))

    def _shaped(self) -> tuple[str, ...]:
        """Messages on a recipe that says something else now; another label table is painted with from now on."""
        session, table = self._opened.session, self._history.recipe.table
        before, now = _label_rows(session.table), _label_rows(table)
        session.use_table(table)
        changed: tuple[str, ...] = ()
        if before != now:
            changed = (text_message("label_table", labels=now),)
            # what is said of a label that is gone is forgotten, also where one of that name is added later
            keep_locks(session, self._locks)
            keep_places(session, self._right)
        return *changed, self._shape(), self._structures()

    def _shape(self) -> str:
        return text_message("shape", **self._shaping.shape())

    def _told(self, request: Request, *messages: str) -> Answer:
        return Answer(for_all=(*messages, self._done()), done=self._done(request))

    def _painted(self, request: Request, box: Box | None, pages: Collection[object]) -> Answer:
        """Labels that changed in a box or are put off: each page is sent what it shows, and may ask for the rest."""
        session = self._opened.session
        if (put_off := session.put_off_tiles).any():
            for shown in self._shown.values():
                shown.note(put_off)
        if (session.is_dividing or put_off.any()) and not self._shown.keys() >= set(pages):
            # who does not say what it shows is sent everything
            k, j, i = (slice(0, n) for n in session.labels.shape)
            box = k, j, i
        if box is not None:
            session.settle_boxes([box])
        labels = () if box is None else (boxes_message([box], session.labels_so_far([box])),)
        in_sight = {page: shown.in_sight() for page, shown in self._shown.items() if shown.has_rest}
        return Answer((*labels, self._done()), self._done(request), for_each=in_sight)

    def _done(self, request: Request | None = None) -> str:
        number = {} if request is None else {"id": request.id}
        is_dividing = self._opened.session.is_dividing
        rest = is_dividing or any(shown.has_rest for shown in self._shown.values())
        return text_message("done", **number, **self._counts(), rest=rest, dividing=is_dividing)

    def _seen(self, request: Look | Rest, shown: Shown) -> str:
        is_dividing = self._opened.session.is_dividing
        return text_message("seen", id=request.id, rest=shown.has_rest or is_dividing, dividing=is_dividing)

    def _counts(self) -> dict[str, Any]:
        history, is_saved = self._history, self.is_saved
        last, following = history.last if is_saved else None, history.next if is_saved else None
        return {
            "undo_count": history.undo_count + (not is_saved),
            "redo_count": history.redo_count if is_saved else 0,
            "undo_kind": last.kind if last else STROKE,
            "redo_kind": following.kind if following else STROKE,
            "saved": is_saved,
        }

    def _close_stroke(self) -> None:
        self._drawn_by = None
        if not self.is_saved:
            self._history.paint(self._opened.session.strokes[-1])

    def _structures(self) -> str:
        """What is known of the structures: their volumes too, unless these take long; then the rest ends with them."""
        session = self._opened.session
        marked = session.marked_values()
        names = {label.value: label.name for label in session.table}
        self._tells_volumes = self._tells_volumes or not session.is_settled
        return text_message(
            "structures",
            **({"volumes_ml": self._volumes_ml()} if session.is_settled else {}),
            marked=[names[value] for value in sorted(marked) if value in names],
            locked=[names[value] for value in sorted(session.locked)],
            checklist=self._checklist(marked),
        )

    def _volumes_ml(self) -> dict[str, float]:
        session = self._opened.session
        found = session.volumes_ml()
        return {one.name: round(float(found[one.value]), 3) for one in session.table if one.value != BACKGROUND}

    def _checklist(self, marked: Collection[int]) -> list[dict[str, Any]]:
        """What a model still needs, in the order in which it is best painted."""
        table, recipe = self._opened.session.table, self._history.recipe
        atria = [label.value for code in _ATRIA if (label := table.find_code(code)) is not None]
        vessels = [label.value for label in table if label.role is Role.VESSEL_LUMEN]
        ended = {label.value for end in recipe.ends if (label := table.find(end.label)) is not None}
        groups = (
            ("background", [BACKGROUND], marked),
            ("chambers", [one.value for one in table if one.role is Role.BLOOD and one.value not in atria], marked),
            ("atria", atria, marked),
            ("vessels", vessels, marked),
            ("myocardium", [label.value for label in table if label.role is Role.MYOCARDIUM], marked),
            ("ends", vessels, set(vessels) if recipe.walls.find_ends else ended),
        )
        return [
            {
                "key": key,
                "done": set(values) <= set(there),
                "missing": [table[v].name for v in values if v not in there],
            }
            for key, values, there in groups
            if values
        ]


def open_painting(path: Path, *, out: Path, listener: BuildListener) -> Painting:
    """Open a recipe for painting and shaping, with what was done and taken back before.

    Parameters
    ----------
    path
        The recipe's file.
    out
        Directory that the case is built in, with the build's cache.
    listener
        Told of progress.

    Raises
    ------
    HeartcaseError
        A problem with the recipe, its scan or its markers.
    """
    recipe = parse_recipe(read_recipe_text(path), needs_markers=False)
    if not scan_is_made(recipe.scan, path.parent):
        listener.stage_started("scan", seconds_expected=0.0, seconds_after=0.0)
        ensure_scan(recipe.scan, path.parent)
    opened = open_session(path, out=out, listener=listener, resumes=True)
    history = open_history(path, out=out)
    opened.session.offer_again(history.undone_strokes)
    return Painting(opened, history, history.log.with_suffix(".locks.json"))


def _label_rows(table: LabelTable) -> list[dict[str, Any]]:
    """What a page shows of the labels."""
    return [
        {"value": label.value, "name": label.name, "colour": label.colour, "role": label.role.value} for label in table
    ]


def _preview(request: Preview, make: Callable[[], QuickSurface]) -> Callable[[], tuple[str | bytes, ...]]:
    def messages() -> tuple[str | bytes, ...]:
        surface = make()
        problems = [{"place": problem.place, "message": problem.message} for problem in surface.problems]
        return surface_message(surface), text_message("preview", id=request.id, problems=problems)

    return messages


def _window(scan: Scan) -> tuple[float, float]:
    """Intensities that are shown black and white at first."""
    if scan.modality == "CT":
        return _CT_WINDOW
    low, high = (float(x) for x in np.percentile(scan.values[::2, ::2, ::2], _WINDOW_PERCENTILES))
    return (low, high) if math.nextafter(low, high) < high else (low, low + 1.0)
