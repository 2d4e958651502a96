"""What stands around a heart on the table, as places and sizes: cannulae at the case's own vessels.

A cannula is there only where the case says where: at the ends of the caval veins, and on the front of the ascending
aorta, which is known from the aortic valve and the surface. Where it says nothing there is none. Shapes are the page's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from heartcase.pipeline.report.views import places_of
from heartcase.schemas.arrays import Float64
from heartcase.schemas.bundle.format import CaseManifest
from heartcase.simulator.load import Case

__all__ = ["cannulae"]

_AORTA, _SUPERIOR, _INFERIOR = "15825003", "48345005", "64131007"
_CAVAL = {_SUPERIOR: "superior", _INFERIOR: "inferior"}
_ABOVE_VALVE_MM = (15.0, 45.0)
"""How far above the aortic valve the aorta is cannulated: beyond its root, before its arch."""
_SHARE = 0.5
"""Radius of a caval cannula over that of its vessel."""
_AORTIC_RADIUS_MM = 3.5
_INTO_AORTA = np.array([0.0, 0.6, -0.8])
"""Way of an aortic cannula into the vessel: from the front and the head."""


def cannulae(case: Case) -> list[dict[str, Any]]:
    """The cannulae of a case.

    Parameters
    ----------
    case
        The case, loaded with surface and structures.

    Returns
    -------
    list
        Of each: ``vessel`` (``aorta``, ``superior``, ``inferior``), ``tip_mm`` in the vessel, ``wall_mm`` where it
        passes the wall or the end (LPS mm), ``out``, the way out there, and ``radius_mm``.
    """
    found = [one for one in (_aortic(case),) if one is not None]
    table = case.manifest.labels
    names = {label.name: _CAVAL[label.snomed] for label in table if label.snomed in _CAVAL}
    there = set()
    for label, position, axis, radius in _ends(case.manifest):
        vessel = names.get(label)
        if vessel is None or vessel in there:
            continue
        there.add(vessel)
        size = _SHARE * radius
        found.append(_cannula(vessel, position - 2.0 * radius * axis, position, axis, size))
    return found


def _ends(manifest: CaseManifest) -> list[tuple[str, Float64, Float64, float]]:
    """Vessel, place, way out and radius of each vessel end that the case was built with."""
    found = []
    for record in manifest.stages:
        for end in record.settings.get("ends") or ():
            try:
                axis = np.array(end["axis"], dtype=float)
                axis = axis / np.linalg.norm(axis)
                found.append(
                    (str(end["label"]), np.array(end["position_mm"], dtype=float), axis, float(end["radius_mm"]))
                )
            except (KeyError, TypeError, ValueError):
                continue
    return found


def _aortic(case: Case) -> dict[str, Any] | None:
    valve = places_of(case.manifest.landmarks).get("aortic valve")
    aorta = case.manifest.labels.find_code(_AORTA)
    if valve is None or aorta is None or case.surface is None or case.triangle_structures is None:
        return None
    walls = [label.value for label in case.manifest.labels if label.wall_of == aorta.value]
    outside = case.surface.triangles[np.isin(case.triangle_structures, walls)]
    places = case.surface.rest_mm[np.unique(outside)].astype(float)
    rise = places[:, 2] - valve.position_mm[2]
    beside = np.linalg.norm((places - valve.position_mm)[:, :2], axis=1)
    low, high = _ABOVE_VALVE_MM
    places = places[(rise > low) & (rise < high) & (beside < high)]
    if not len(places):
        return None
    # the middle of its height, there what is most in front
    height = np.abs(places[:, 2] - valve.position_mm[2] - 0.6 * (low + high))
    places = places[height <= height.min() + 3.0]
    wall = places[places[:, 1].argmin()]
    return _cannula("aorta", wall + 3.0 * _AORTIC_RADIUS_MM * _INTO_AORTA, wall, -_INTO_AORTA, _AORTIC_RADIUS_MM)


def _cannula(vessel: str, tip: Float64, wall: Float64, out: Float64, radius: float) -> dict[str, Any]:
    return {
        "vessel": vessel,
        "tip_mm": tip.tolist(),
        "wall_mm": wall.tolist(),
        "out": out.tolist(),
        "radius_mm": radius,
    }
