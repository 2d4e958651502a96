"""Stitches and patches of a moment as arrays of a recording, and back: to the last digit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.patching.flat_sheets import FlatSheet
from heartcase.simulator.patching.patches import Patch, bind_rim
from heartcase.simulator.suturing.places import Place
from heartcase.simulator.suturing.stitches import Stitch, bind

__all__ = ["patch_arrays", "patches_from", "stitch_arrays", "stitch_names", "stitches_from"]

Arrays = dict[str, npt.NDArray[Any]]
_NUMBERS = ("stiffness", "length", "length_target", "tension_most", "tension_target", "is_tied")


def stitch_arrays(stitches: Sequence[Stitch]) -> Arrays:
    """Where each stitch is bound and how it is drawn; the nodes follow from what was cut."""
    places = [[(place.cell, place.sample) for place in stitch.places] for stitch in stitches]
    locals_ = [[place.local for place in stitch.places] for stitch in stitches]
    numbers = [[float(getattr(stitch, name)) for name in _NUMBERS] for stitch in stitches]
    return {
        "stitch_places": np.array(places, np.int64),
        "stitch_local": np.array(locals_, np.float64),
        "stitch_numbers": np.array(numbers, np.float64),
    }


def stitch_names(stitches: Sequence[Stitch]) -> list[tuple[str, str, bool]]:
    """Name and row of each, and whether one thread runs through the row."""
    return [(stitch.name, stitch.row, stitch.is_running) for stitch in stitches]


def stitches_from(
    arrays: Arrays, names: Sequence[Sequence[Any]], model: LatticeModel, cuts: Cuts | None
) -> list[Stitch]:
    """The stitches that such arrays hold, in a lattice that some cuts leave.

    Raises
    ------
    ValueError, KeyError
        They do not fit the names, or the lattice.
    """
    places, local, numbers = (arrays[f"stitch_{name}"] for name in ("places", "local", "numbers"))
    count = len(names)
    cell_count = model.cell_count if cuts is None else cuts.uncut.cell_count
    is_whole = (
        places.shape == (count, 2, 2) and local.shape == (count, 2, 3) and numbers.shape == (count, len(_NUMBERS))
    )
    if not is_whole or places.dtype != np.int64 or places.min() < 0:
        raise ValueError("stitches")
    if places[..., 0].max() >= cell_count or places[..., 1].max() >= len(SAMPLE_PLACES):
        raise ValueError("stitches")
    if not (np.isfinite(numbers).all() and (numbers[:, 0] > 0).all() and (local >= 0).all() and (local <= 1).all()):
        raise ValueError("stitches")
    stitches = []
    for name, where, at, said in zip(names, places.tolist(), local.tolist(), numbers.tolist(), strict=True):
        ends = tuple(Place(cell, sample, tuple(place)) for (cell, sample), place in zip(where, at, strict=True))
        nodes, shares = bind(model, cuts, (ends[0], ends[1]))
        stiffness, *drawn, is_tied = said
        length, length_target, most, most_target = drawn
        thread = (nodes, shares, stiffness, length, length_target, most, most_target)
        stitch = Stitch((ends[0], ends[1]), *thread, is_tied=bool(is_tied))
        own, row, is_running = name
        stitch.name, stitch.row, stitch.is_running = str(own), str(row), bool(is_running)
        stitches.append(stitch)
    return stitches


def patch_arrays(patches: Sequence[Patch]) -> Arrays:
    """What each patch was cut to, and where its rim is bound."""
    arrays: Arrays = {}
    for number, patch in enumerate(patches):
        sheet, place = patch.sheet, f"patch_{number}_"
        numbers = [patch.stiffness_n_m, patch.thickness_mm, patch.first, patch.stitch_stiffness]
        numbers += [sheet.stretch_least, sheet.stretch_most, sheet.scale]
        arrays |= {
            place + "places": np.array([(one.cell, one.sample) for one in patch.places], np.int64),
            place + "local": np.array([one.local for one in patch.places], np.float64),
            place + "flat": sheet.flat_mm.astype(np.float64),
            place + "spanned": sheet.spanned_mm.astype(np.float64),
            place + "triangles": sheet.triangles.astype(np.int32),
            place + "numbers": np.array(numbers, np.float64),
        }
    return arrays


def patches_from(arrays: Arrays, names: Sequence[str], model: LatticeModel, cuts: Cuts | None) -> list[Patch]:
    """The patches that such arrays hold, in a lattice that some cuts leave and that has their nodes.

    Raises
    ------
    ValueError, KeyError
        They do not fit the lattice.
    """
    patches = []
    cell_count = model.cell_count if cuts is None else cuts.uncut.cell_count
    for number, name in enumerate(names):
        places, local, flat, spanned, triangles, numbers = (
            arrays[f"patch_{number}_{what}"] for what in ("places", "local", "flat", "spanned", "triangles", "numbers")
        )
        rim, count = len(places), len(flat)
        is_whole = places.shape == (rim, 2) and local.shape == (rim, 3) and flat.shape == (count, 2)
        is_whole &= spanned.shape == (count, 3) and triangles.shape[1:] == (3,) and numbers.shape == (7,)
        if not is_whole or not 3 <= rim <= count or places.dtype != np.int64 or triangles.dtype != np.int32:
            raise ValueError("patches")
        if places.min() < 0 or places[:, 0].max() >= cell_count or places[:, 1].max() >= len(SAMPLE_PLACES):
            raise ValueError("patches")
        if not len(triangles) or triangles.min() < 0 or triangles.max() >= count:
            raise ValueError("patches")
        if not all(np.isfinite(array).all() for array in (local, flat, spanned, numbers)):
            raise ValueError("patches")
        stiffness, thickness, first, own, least, most, scale = numbers.tolist()
        if not (0 <= first <= model.loose_count - count and own > 0 and (local >= 0).all() and (local <= 1).all()):
            raise ValueError("patches")
        sheet = FlatSheet(flat, spanned, triangles, rim, least, most, scale)
        at = tuple(
            Place(cell, sample, (x, y, z))
            for (cell, sample), (x, y, z) in zip(places.tolist(), local.tolist(), strict=True)
        )
        patch = Patch(str(name), sheet, at, stiffness, thickness, int(first), own)
        bind_rim(patch, model, cuts)
        patches.append(patch)
    return patches
