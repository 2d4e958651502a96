"""Painting on a recipe, as a page drives it: strokes that grow, saved when they are over, taken back at any time."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.library.scans import ensure_scan
from heartcase.pipeline.building.runner import BuildListener
from heartcase.pipeline.building.session_file import RecipeSession, open_session
from heartcase.pipeline.data import UNMARKED, Scan
from heartcase.pipeline.watershed.forest import Box
from heartcase.schemas.errors import HeartcaseError, RecipeError, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.labels import BACKGROUND, Role
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from heartcase.schemas.recipe.settings import Stroke
from heartcase.studio.messages import labels_message, scan_message, text_message
from heartcase.studio.planes import planes_message
from heartcase.studio.requests import End, Extend, History, Paint, Planes, Request, Suggest

__all__ = ["Answer", "Painting", "open_painting"]

_CT_WINDOW = (-150.0, 450.0)
"""Contrast-filled chambers, muscle and fat, HU."""
_WINDOW_PERCENTILES = (1.0, 99.5)


@dataclass(frozen=True)
class Answer:
    """What comes of a request."""

    for_all: tuple[str | bytes, ...] = ()
    """Messages for every page on the recipe, in this order."""
    done: str | None = None
    """For the page that asked, after these."""


class Painting:
    """A recipe that is being painted on.

    Parameters
    ----------
    opened
        The recipe, and the session on its scan.
    undone
        File that remembers the strokes that were taken back, for when the recipe is opened again.
    """

    def __init__(self, opened: RecipeSession, undone: Path) -> None:
        self._opened = opened
        self._undone = undone
        self._drawn_by: object | None = None
        self._is_saved = True

    @property
    def is_stale(self) -> bool:
        """Whether another program changed the recipe since it was read or written here."""
        try:
            return read_recipe_text(self._opened.path) != self._opened.written_text
        except RecipeError:
            return True

    def greeting(self) -> tuple[str | bytes, ...]:
        """All that a page needs to show the recipe as it is now."""
        opened, session = self._opened, self._opened.session
        scan, geometry = opened.scan, session.geometry
        low, high = _window(scan)
        facts = text_message(
            "opened",
            name=opened.recipe.name,
            size=geometry.size,
            spacing_mm=geometry.spacing_mm,
            index_to_world=geometry.affine.tolist(),
            modality=scan.modality if scan.modality in ("CT", "MR") else None,
            labels=[
                {"value": label.value, "name": label.name, "colour": label.colour, "role": label.role.value}
                for label in session.table
            ],
            unmarked=UNMARKED,
            window={"low": low, "high": high},
            range={"low": float(scan.values.min()), "high": float(scan.values.max())},
            **self._counts(),
        )
        everything = (slice(0, n) for n in geometry.shape)
        k, j, i = everything
        return facts, scan_message(scan), labels_message(session.labels, (k, j, i)), self._structures()

    def do(self, request: Request, page: object) -> Answer:
        """Carry a request out.

        Parameters
        ----------
        request
            What is asked.
        page
            Who asks: a stroke goes on for the page that began it.

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
                self._drawn_by, self._is_saved = page, False
                return self._painted(request, box)
            case Extend():
                if self._drawn_by is not page:
                    raise UsageError("there is no stroke to go on with: begin one", place="extend")
                return self._painted(request, session.extend(request.points_mm))
            case End():
                if self._drawn_by is page:
                    self._close_stroke()
                return Answer((self._structures(), self._done()), self._done(request))
            case History():
                self._close_stroke()
                box = session.undo() if request.do == "undo" else session.redo()
                self._is_saved = False
                self._save()
                answer = self._painted(request, box)
                return Answer((*answer.for_all, self._structures()), answer.done)
            case Suggest():
                found = session.suggest(count=request.count).as_json(session.table)
                return Answer(done=text_message("places", id=request.id, **found))
            case Planes():
                return Answer(done=planes_message(request.id, self._opened))

    def leave(self, page: object) -> tuple[str, ...]:
        """Whoever drew is gone: the stroke ends where it is; messages for the pages that are left."""
        if self._drawn_by is not page:
            return ()
        self._close_stroke()
        return self._structures(), self._done()

    def _painted(self, request: Request, box: Box | None) -> Answer:
        shown = () if box is None else (labels_message(self._opened.session.labels, box),)
        return Answer((*shown, self._done()), self._done(request))

    def _done(self, request: Request | None = None) -> str:
        number = {} if request is None else {"id": request.id}
        return text_message("done", **number, **self._counts())

    def _counts(self) -> dict[str, Any]:
        session = self._opened.session
        return {"undo_count": len(session.strokes), "redo_count": session.redo_count, "saved": self._is_saved}

    def _close_stroke(self) -> None:
        self._drawn_by = None
        if not self._is_saved:
            self._save()

    def _save(self) -> None:
        self._opened.save()
        undone = [stroke.model_dump(mode="json", exclude_defaults=True) for stroke in self._opened.session.undone]
        _remember(self._undone, self._opened.written_text, undone)
        self._is_saved = True

    def _structures(self) -> str:
        session = self._opened.session
        found = np.bincount(session.labels.ravel(), minlength=256) * (session.geometry.voxel_volume_mm3 / 1000.0)
        marked = set(np.flatnonzero(np.bincount(session.marked.ravel(), minlength=256)).tolist()) - {UNMARKED}
        names = {label.value: label.name for label in session.table}
        return text_message(
            "structures",
            volumes_ml={name: round(float(found[value]), 3) for value, name in names.items() if value != BACKGROUND},
            marked=[names[value] for value in sorted(marked) if value in names],
            checklist=self._checklist(marked),
        )

    def _checklist(self, marked: set[int]) -> list[dict[str, Any]]:
        """What a model still needs, in the order in which it is best painted."""
        table = self._opened.session.table
        groups = (
            ("background", [BACKGROUND]),
            ("chambers", [label.value for label in table if label.role is Role.BLOOD]),
            ("vessels", [label.value for label in table if label.role is Role.VESSEL_LUMEN]),
            ("myocardium", [label.value for label in table if label.role is Role.MYOCARDIUM]),
        )
        return [
            {"key": key, "done": set(values) <= marked, "missing": [table[v].name for v in values if v not in marked]}
            for key, values in groups
            if values
        ]


def open_painting(path: Path, *, out: Path, listener: BuildListener) -> Painting:
    """Open a recipe for painting, with what was painted and taken back before.

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
    ensure_scan(recipe.scan, path.parent)
    opened = open_session(path, out=out, listener=listener, resumes=True)
    name = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]
    undone = out / ".heartcase-cache" / "studio" / f"{name}.json"
    opened.session.offer_again(_remembered(undone, opened.written_text))
    return Painting(opened, undone)


def _window(scan: Scan) -> tuple[float, float]:
    """Intensities that are shown black and white at first."""
    if scan.modality == "CT":
        return _CT_WINDOW
    low, high = (float(x) for x in np.percentile(scan.values[::2, ::2, ::2], _WINDOW_PERCENTILES))
    return (low, high) if math.nextafter(low, high) < high else (low, low + 1.0)


def _remember(file: Path, recipe_text: str, undone: Sequence[dict[str, Any]]) -> None:
    """Write down what was taken back; the recipe holds the rest."""
    data = {"recipe_sha256": hashlib.sha256(recipe_text.encode()).hexdigest(), "undone": list(undone)}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(file, json.dumps(data).encode())
    except OSError:
        # The recipe is saved: all that is lost is a redo after the next start.
        return


def _remembered(file: Path, recipe_text: str) -> tuple[Stroke, ...]:
    """The strokes that were taken back when the recipe was as it is now; none where that is not known."""
    try:
        data = json.loads(file.read_bytes())
        if data["recipe_sha256"] != hashlib.sha256(recipe_text.encode()).hexdigest():
            return ()
        return tuple(Stroke.model_validate(stroke) for stroke in data["undone"])
    except (OSError, ValueError, KeyError, TypeError, HeartcaseError):
        return ()
