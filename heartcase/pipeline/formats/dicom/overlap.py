"""Slice positions that hold several images, as where two slabs of a step-and-shoot scan meet.

Pixels decide: the same ones are copies, others are two images of one place, each as good as the other, and the user
says whether the one that was acquired earlier or later is taken. Nothing else tells which: not the files' names, not
the instance numbers.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Literal

import numpy as np

from heartcase.pipeline.formats.dicom.pixels import read_pixels
from heartcase.pipeline.formats.dicom.stack import Slice, places_of
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.errors import ScanError

__all__ = ["Overlap", "one_at_each_place"]

Overlap = Literal["earlier", "later"]
NAMED = 5
"""How many slices a message names."""
SETTING = "--overlap earlier or --overlap later, or overlap in the recipe's [scan]"


def one_at_each_place(slices: Sequence[Slice], overlap: Overlap | None) -> tuple[tuple[Slice, ...], list[CaseWarning]]:
    """One image of each slice position where some positions hold several.

    Parameters
    ----------
    slices
        Placed images of one orientation, in any order.
    overlap
        Which image of a position is taken; None where the user does not say.

    Returns
    -------
    slices
        The images; all of them where no position repeats, or where each is there equally often and nothing is told.
    notes
        A line that says where one of several was taken.

    Raises
    ------
    ScanError
        Some positions hold several images and it is not told which to take, or the headers do not tell which of them
        was acquired first.
    """
    if any(None in (image.position, image.orientation, image.spacing) for image in slices):
        return tuple(slices), []
    at_place: dict[int, list[Slice]] = defaultdict(list)
    for place, image in zip(places_of(slices).tolist(), slices, strict=True):
        at_place[place].append(image)
    counts = {len(images) for images in at_place.values()}
    if counts == {1} or len(at_place) == 1 or (overlap is None and len(counts) == 1):
        return tuple(slices), []
    doubled = sorted(place for place, images in at_place.items() if len(images) > 1)
    if overlap is None:
        raise ScanError(_advice(at_place, doubled))
    kept = []
    for place, images in sorted(at_place.items()):
        ordered = _in_time(images)
        if ordered is None and not _are_copies(images):
            raise ScanError(
                f"slice {place + 1} is there {len(images)} times, and the headers do not tell which image was acquired "
                "first (acquisition number or time): export the one that is wanted alone"
            )
        kept.append((ordered or images)[0 if overlap == "earlier" else -1])
    several = len(doubled) > 1
    return tuple(kept), [
        CaseWarning(
            f"slice{'s' if several else ''} {_numbers(doubled)} {'are' if several else 'is'} there twice or more, as "
            f"where two acquisitions meet: of each the {overlap} image was taken"
        )
    ]


def _advice(at_place: dict[int, list[Slice]], doubled: list[int]) -> str:
    several = len(doubled) > 1
    what = f"{len(doubled)} slice{'s are' if several else ' is'} there twice (slice{'s' * several} {_numbers(doubled)})"
    if all(_are_copies(at_place[place]) for place in doubled):
        return f"{what}, with the same pixels: remove the copies"
    images = f"{what}, and the images differ, as where two acquisitions meet"
    if all(_in_time(at_place[place]) for place in doubled):
        return f"{images}: take one of them with {SETTING}"
    return (
        f"{images}, but the headers do not tell which was acquired first (acquisition number or time): export the one "
        "that is wanted alone"
    )


def _in_time(images: list[Slice]) -> list[Slice] | None:
    """The images in the order in which they were acquired; None where that is not told."""
    for key in ([image.traits.get("acquisition_number") for image in images], [image.acquired_s for image in images]):
        numbers = [number for number in key if isinstance(number, float)]
        if len(numbers) == len(images) == len(set(numbers)):
            return [images[index] for index in np.argsort(numbers)]
    return None


def _are_copies(images: list[Slice]) -> bool:
    if len({image.shape for image in images}) > 1:
        return False
    values = [read_pixels((image,)) for image in images]
    return all(np.array_equal(values[0], other, equal_nan=True) for other in values[1:])


def _numbers(places: list[int]) -> str:
    shown = ", ".join(str(place + 1) for place in places[:NAMED])
    return shown + (f" and {len(places) - NAMED} more" if len(places) > NAMED else "")
