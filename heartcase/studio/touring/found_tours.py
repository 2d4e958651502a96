"""The tours of a case: those beside it or its recipe, and those that come with heartcase."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.recipe.recipe import parse_recipe, read_recipe_text
from heartcase.schemas.touring.reading import TOUR_ENDING, load_tour
from heartcase.schemas.touring.tour import Tour
from heartcase.simulator.touring.case_places import CasePlaces
from heartcase.simulator.touring.staging import StagedScene, staged_scenes

__all__ = ["FoundTours", "ShownTour", "find_tours", "tour_folders", "tours_sha256"]

_MOST = 20
"""Tours of a case that are shown at most."""
_LOOKED_AT_MAX = 2000
"""Tours, or recipes, that are looked at in a folder, at most."""
_RECIPE_START = 4096
"""Bytes of a file in which a recipe says that it is one."""


@dataclass(frozen=True)
class ShownTour:
    """A tour of a case."""

    tour: Tour
    """What it says."""
    scenes: tuple[StagedScene, ...]
    """What each step shows on the case."""

    def as_data(self) -> dict[str, Any]:
        """What a page is told of it."""
        said = self.tour.model_dump(mode="json", by_alias=True)
        return {
            "title": self.tour.title,
            "language": self.tour.head.language,
            "blocks": said["blocks"],
            "steps": [
                {
                    "title": step.title,
                    "blocks": data["blocks"],
                    "question": data["question"],
                    "scene": asdict(scene),
                    "acts": bool(step.acts),
                }
                for step, data, scene in zip(self.tour.steps, said["steps"], self.scenes, strict=True)
            ],
        }


@dataclass(frozen=True)
class FoundTours:
    """The tours of a case."""

    shown: tuple[ShownTour, ...]
    """Those that can be shown."""
    problems: tuple[Problem, ...]
    """What is wrong with others that stand beside the case or its recipe."""


def find_tours(places: CasePlaces, folders: Iterable[Path], samples: Path | None) -> FoundTours:
    """The tours of a case, those beside it first.

    Parameters
    ----------
    places
        Places of the case.
    folders
        Where tours of this case may stand: its folder's, its recipe's. Those of other cases are passed over.
    samples
        Folder of the sample cases, whose tours are for synthetic hearts of these names; None where there is none.
    """
    manifest = places.case.manifest
    shown: list[ShownTour] = []
    problems: list[Problem] = []
    is_synthetic = manifest.about is not None and manifest.about.origin == "synthetic"
    own = dict.fromkeys(one.resolve() for one in folders)
    for path, is_own in [
        *((path, True) for folder in own for path in _tours_in(folder)),
        *((path, False) for path in (_tours_in(samples) if samples is not None and is_synthetic else ())),
    ]:
        if len(shown) == _MOST:
            break
        try:
            tour = load_tour(path)
            if tour.head.case.lower() == manifest.name.lower():
                shown.append(ShownTour(tour, staged_scenes(tour, places)))
        except HeartcaseError as error:
            # One that cannot be read may be of this case: who wrote it wants to know.
            if is_own:
                problems += error.problems
    return FoundTours(tuple(shown), tuple(problems))


def tour_folders(case: Path, name: str) -> list[Path]:
    """Where tours of a case may stand: its own folder, and the one above where a recipe of the case's name lies there.

    Parameters
    ----------
    case
        The case's folder.
    name
        Its name.
    """
    folder = case.resolve().parent
    return [folder, folder.parent] if _has_recipe(folder.parent, name) else [folder]


def _has_recipe(folder: Path, name: str) -> bool:
    try:
        paths = sorted(one for one in folder.iterdir() if one.suffix == ".toml" and one.is_file())
    except OSError:
        return False
    for path in paths[:_LOOKED_AT_MAX]:
        with contextlib.suppress(HeartcaseError, OSError, ValueError):
            with path.open("rb") as file:
                head = file.read(_RECIPE_START)
            if b"heartcase_recipe" not in head:
                continue
            if parse_recipe(read_recipe_text(path), needs_markers=False).name.lower() == name.lower():
                return True
    return False


def tours_sha256(folders: Iterable[Path]) -> str:
    """Hash of all tours in some folders: what is made with them is as new as they are where it stays the same."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in _tours_in(folder):
            with contextlib.suppress(OSError):
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _tours_in(folder: Path) -> Iterator[Path]:
    try:
        paths = sorted(one for one in folder.iterdir() if one.name.lower().endswith(TOUR_ENDING) and one.is_file())
    except OSError:
        return
    yield from paths[:_LOOKED_AT_MAX]
