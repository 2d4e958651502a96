"""Places that somebody looked at and found right: what pages keep beside the recipe, which says nothing of it."""

from __future__ import annotations

import json
from pathlib import Path

from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.markers.suggest import RightPlace
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write

__all__ = ["MOST_PLACES", "confirm_again", "confirm_place", "keep_places"]

MOST_PLACES = 1000
"""The oldest ones go first."""


def confirm_place(
    session: SegmentationSession, position_mm: tuple[float, float, float], label: str, rival: str, *, file: Path
) -> None:
    """Note that a place is right, also after the next start.

    Parameters
    ----------
    session
        What is painted on.
    position_mm
        The place, as it was named, LPS mm.
    label, rival
        Names of the label that it has, and of the one that it might have had.
    file
        Where it is remembered.

    Raises
    ------
    UsageError
        There is no such label.
    """
    values = []
    for name in (label, rival):
        found = session.table.find(name)
        if found is None:
            raise UsageError(f"there is no label {name!r}", place="confirm")
        values.append(found.value)
    places = dict.fromkeys((*session.right_places, RightPlace(position_mm, *values)))
    session.right_places = tuple(places)[-MOST_PLACES:]
    keep_places(session, file)


def keep_places(session: SegmentationSession, file: Path) -> None:
    """Remember in a file which places are right."""
    names = {one.value: one.name for one in session.table}
    lines = [
        {"position_mm": one.position_mm, "label": names[one.label], "rival": names[one.rival]}
        for one in session.right_places
    ]
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(file, json.dumps({"right": lines}).encode())
    except OSError:
        # they are right as long as the server runs
        return


def confirm_again(session: SegmentationSession, file: Path) -> None:
    """Find right again what was before; nothing where that is not known."""
    found = []
    try:
        for one in json.loads(file.read_bytes())["right"][-MOST_PLACES:]:
            x, y, z = (float(value) for value in one["position_mm"])
            label, rival = (session.table.find(str(one[key])) for key in ("label", "rival"))
            if label is not None and rival is not None:
                found.append(RightPlace((x, y, z), label.value, rival.value))
    except (OSError, ValueError, KeyError, TypeError):
        return
    session.right_places = tuple(found)
