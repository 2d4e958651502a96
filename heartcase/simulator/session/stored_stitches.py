"""Stitches of a moment as arrays of a recording, and back: to the last digit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.cutting.tissue_samples import SAMPLE_PLACES
from heartcase.simulator.lattice.model import LatticeModel
from heartcase.simulator.suturing.places import Place
from heartcase.simulator.suturing.stitches import Stitch, bind

__all__ = ["stitch_arrays", "stitches_from"]

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


def stitches_from(arrays: Arrays, names: Sequence[str], model: LatticeModel, cuts: Cuts | None) -> list[Stitch]:
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
        stitches.append(Stitch((ends[0], ends[1]), *thread, is_tied=bool(is_tied), name=str(name)))
    return stitches
