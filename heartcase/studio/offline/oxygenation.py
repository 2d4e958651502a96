"""Which cavities hold oxygen-rich blood, which oxygen-poor, and which both, worked out from what opens into what.

Blood runs from veins to atria to ventricles to arteries. Each cavity takes what the ones before it hold, through the
openings that a normal heart has or that the recipe states. Which way blood crosses a defect between two cavities of
one rank is known only where one of them has no other way in or out; elsewhere both may be mixed, and what lies behind
them is left as it would be without the defect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from heartcase.schemas.labels import Label, LabelTable

__all__ = ["Oxygen", "Oxygenation", "oxygenation"]

Pair = tuple[int, int]


class Oxygen(StrEnum):
    """What blood a structure holds; a wall goes by its cavity."""

    RICH = "rich"
    """From the lungs."""
    POOR = "poor"
    """From the body."""
    MIXED = "mixed"
    """Both, or perhaps both: it is joined to a cavity of the other kind."""
    UNKNOWN = "unknown"
    """The vocabulary does not tell."""


@dataclass(frozen=True)
class Oxygenation:
    """Oxygenation of all structures of a case."""

    of_label: Mapping[int, Oxygen]
    """Label value -> its blood; for every label but the background."""
    is_from_openings: bool
    """Whether the case told what opens into what; otherwise it goes by structure alone, as in a normal heart."""
    joined: tuple[tuple[str, str], ...] = ()
    """Names of cavities that a defect joins, the direction of flow unknown."""


_VEIN, _ATRIUM, _VENTRICLE, _ARTERY = range(4)
_PLACES: dict[str, tuple[int, Oxygen]] = {
    "superior vena cava": (_VEIN, Oxygen.POOR),
    "inferior vena cava": (_VEIN, Oxygen.POOR),
    "coronary sinus": (_VEIN, Oxygen.POOR),
    "pulmonary vein": (_VEIN, Oxygen.RICH),
    "morphologically right atrium": (_ATRIUM, Oxygen.POOR),
    "morphologically left atrium": (_ATRIUM, Oxygen.RICH),
    "morphologically right ventricle": (_VENTRICLE, Oxygen.POOR),
    "morphologically left ventricle": (_VENTRICLE, Oxygen.RICH),
    "pulmonary artery": (_ARTERY, Oxygen.POOR),
    "aorta": (_ARTERY, Oxygen.RICH),
}
"""Term -> rank along the way of the blood, and what it holds in a normal heart."""
_GOES_WITH = {
    "left atrial appendage": "morphologically left atrium",
    "right atrial appendage": "morphologically right atrium",
    "morphologically left ventricular myocardium": "morphologically left ventricle",
    "morphologically right ventricular myocardium": "morphologically right ventricle",
}
_TRUSTED = ("expected", "stated", "other ventricle")
"""Verdicts on openings; what nobody says is meant may be a fault of the segmentation."""


def oxygenation(table: LabelTable, openings: Any) -> Oxygenation:
    """Work out what blood each structure holds.

    Parameters
    ----------
    table
        Label table, walls included.
    openings
        ``quality["openings"]`` of the manifest, in whatever form somebody wrote it; what is not sound is passed over.

    Returns
    -------
    Oxygenation
        By structure alone where no opening between known cavities is told.
    """
    places = {
        label.value: _PLACES[label.term.name]
        for label in table
        if label.role.is_blood and label.term is not None and label.term.name in _PLACES
    }
    pairs = _pairs(openings, places)
    held = {value: own for value, (_, own) in places.items()}
    shunts: list[Pair] = []
    if pairs:
        held, shunts = _flow(places, pairs)
        across = [(a, b) for a, b in shunts if held[a] is not held[b] or held[a] is Oxygen.MIXED]
        held |= {value: Oxygen.MIXED for pair in across for value in pair}
        shunts = across
    by_name = {label.term.name: held[label.value] for label in table if label.value in held and label.term is not None}
    everything = {label.value: _of(label, table, held, by_name) for label in table if label.value != 0}
    return Oxygenation(everything, bool(pairs), tuple((table[a].name, table[b].name) for a, b in shunts))


def _of(label: Label, table: LabelTable, held: Mapping[int, Oxygen], by_name: Mapping[str, Oxygen]) -> Oxygen:
    if label.value in held:
        return held[label.value]
    if label.wall_of is not None and label.wall_of != label.value and label.wall_of in held:
        return held[label.wall_of]
    main = _GOES_WITH.get(label.term.name, "") if label.term is not None else ""
    return by_name.get(main) or (_PLACES[main][1] if main else Oxygen.UNKNOWN)


def _pairs(openings: Any, places: Mapping[int, tuple[int, Oxygen]]) -> list[Pair]:
    """Label values of cavities that are open to each other, the one that comes first in the blood's way first."""
    found: set[Pair] = set()
    for one in openings if isinstance(openings, Sequence) and not isinstance(openings, str) else ():
        labels = one.get("labels") if isinstance(one, Mapping) else None
        if not isinstance(labels, Sequence) or len(labels) != 2 or one.get("verdict") not in _TRUSTED:
            continue
        a, b = labels
        if isinstance(a, int) and isinstance(b, int) and a in places and b in places and a != b:
            found.add((a, b) if (places[a][0], a) < (places[b][0], b) else (b, a))
    return sorted(found)


def _flow(places: Mapping[int, tuple[int, Oxygen]], pairs: Sequence[Pair]) -> tuple[dict[int, Oxygen], list[Pair]]:
    """What each cavity holds, and the pairs through which the way of the blood is not known."""
    rank = {value: place[0] for value, place in places.items()}
    own = {value: place[1] for value, place in places.items()}
    level = [(a, b) for a, b in pairs if rank[a] == rank[b]]
    forward = [(a, b) for a, b in pairs if rank[a] < rank[b]]
    # A valve between an atrium and the other side's ventricle is a defect only where both have their own as well.
    regular = [(a, b) for a, b in forward if own[a] is own[b] and (rank[a], rank[b]) == (_ATRIUM, _VENTRICLE)]
    inlets, outlets = {b for _, b in regular}, {a for a, _ in regular}
    crossed = [
        (a, b)
        for a, b in forward
        if (rank[a], rank[b]) == (_ATRIUM, _VENTRICLE) and own[a] is not own[b] and a in outlets and b in inlets
    ]
    edges = set(forward) - set(crossed)
    shunts = level + crossed
    has_outlet, has_inlet = {a for a, _ in edges}, {b for _, b in edges}

    veins = {own[a] for a, _ in edges if rank[a] == _VEIN}

    def has(step: int, value: int) -> bool:
        """Whether the model has what comes before or after a cavity in a normal heart."""
        return any(rank[other] == rank[value] + step and own[other] is own[value] for other in rank)

    def is_dry(value: int) -> bool:
        """Whether its blood must come by a defect: nothing else leads to it."""
        lacks = own[value] in veins if rank[value] == _ATRIUM else rank[value] > _ATRIUM and has(-1, value)
        return lacks and value not in has_inlet

    def is_blind(value: int) -> bool:
        """Whether its blood must leave by a defect: it leads to nothing else."""
        return rank[value] in (_ATRIUM, _VENTRICLE) and value not in has_outlet and has(1, value)

    for a, b in list(shunts):
        dry, blind = ([value for value in (a, b) if holds(value)] for holds in (is_dry, is_blind))
        if len(dry) == 1:
            edges.add((a + b - dry[0], dry[0]))
        elif len(blind) == 1:
            edges.add((blind[0], a + b - blind[0]))
        else:
            continue
        shunts.remove((a, b))
    return _contents(rank, own, edges), shunts


def _contents(rank: Mapping[int, int], own: Mapping[int, Oxygen], edges: set[Pair]) -> dict[int, Oxygen]:
    """Let the blood run along the edges until nothing changes."""
    veins = {own[a] for a, _ in edges if rank[a] == _VEIN}
    fed = {b for _, b in edges}
    held: dict[int, set[Oxygen]] = {}
    for value in rank:
        # An atrium's veins are often left out of a model; then it holds what it would.
        starts = own[value] not in veins if rank[value] == _ATRIUM else rank[value] == _VEIN or value not in fed
        held[value] = {own[value]} if starts else set()
    for _ in rank:
        for a, b in edges:
            held[b] |= held[a]
    return {value: Oxygen.MIXED if len(kinds) > 1 else next(iter(kinds), own[value]) for value, kinds in held.items()}
