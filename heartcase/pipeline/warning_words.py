r"""The sentences of warnings, by kind: one source for what is said, and for what a page takes out of it.

A sentence is a template. ``{name}`` stands for a value in words, ``{name#}`` for a number; what stands in ``[...]`` is
said where its values are there, and of ``<one|several>`` the first where the value ``count`` is 1; ``[[``, ``]]``,
``\[`` and ``\]`` are brackets. A case holds sentences alone, also one of an older heartcase, so kind and values are
found again by the template: :func:`recognised`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

__all__ = ["SENTENCES", "Recognised", "recognised", "sentence", "value_names"]

SENTENCES: Mapping[str, str] = {
    "grown-septum": (
        "walls were grown where two outlines touch, not seen, because a heart does not join these: {listed}. If "
        "the patient has an opening there, say so: an edit of kind septal_defect, a landmark (ring or point) "
        "whose name says defect, VSD or ASD, or strokes of the two that run into each other through it; if the "
        "two are one, name them in walls.connected"
    ),
    "grown-septum-confirmed": (
        "the wall that was grown between {one} and {other} over {area#} mm² near {place} mm is wall, as the "
        "recipe says (walls.contact)"
    ),
    "contact-not-open": (
        "the recipe says that {one} and {other} are open to each other near {place} mm, but the model has no "
        "opening there: look whether the outlines of the two still touch there, and whether another entry says "
        "that it is wall; then state the opening anew, or take this entry out of the recipe"
    ),
    "contact-no-wall": (
        "the recipe says that the place between {one} and {other} near {place} mm is wall, but no wall was grown "
        "there: look what is there now, and take this entry out of the recipe"
    ),
    "contact-normal": (
        "{one} and {other} are open to each other in every heart, so what the recipe says of the place near "
        "{place} mm has no effect: take this entry out of the recipe, or name the two in [[walls.septum]]"
    ),
    "opening-unexpected": (
        "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near "
        "{place} mm: paint the wall between them (a stroke of background, or of the muscle), or the third cavity "
        "whose blood they were given, if one lies there; or name the two in [[walls.septum]], so that one is "
        "grown; or, if the patient has this opening, say so: an edit of kind septal_defect, or a landmark (point "
        "or ring) there whose name says defect, VSD or ASD"
    ),
    "no-contrast": (
        "the scan has the same intensity everywhere, so the outlines only show which marker is nearest: check "
        "that this is the right scan"
    ),
    "no-background": (
        "nothing is marked as background, so everything beside the heart was taken for heart: paint some of what "
        "is not heart, all around it"
    ),
    "not-painted": "the {label} is not in the model, as nothing was painted for it: paint it if this heart has one",
    "not-found": "the {label} is not in the model, as no part of the scan was found to be it: check the slices",
    "stray-pieces": (
        "the {label} is in {pieces#} pieces; beside the largest: {listed}: look there in the slices whether they "
        "are real"
    ),
    "opening-other-ventricle": (
        "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near "
        "{place} mm: the great artery arises from the other ventricle; is that the malformation?"
    ),
    "opening-unknown": (
        "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near "
        "{place} mm: a name that heartcase does not know, so look whether a wall belongs between them"
    ),
    "valve-narrow": (
        "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near "
        "{place} mm, as a circle of {diameter#} mm: very narrow for this valve, where about {usual#} mm is usual "
        "with ventricles of this volume; check that the labels of the two meet at the valve and that neither has "
        "taken a part of the other, or that this is the malformation"
    ),
    "valve-wide": (
        "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near "
        "{place} mm, as a circle of {diameter#} mm: very wide for this valve, where about {usual#} mm is usual "
        "with ventricles of this volume; check that the labels of the two meet at the valve and that neither has "
        "taken a part of the other, or that this is the malformation"
    ),
    "valve-closed": (
        "the {one} is open to no ventricle, so no blood passes between them: the nearest, the {other}, is {gap#} mm "
        "away near {place} mm; check that the labels of the two meet at the valve, and paint them up to each other "
        "there, or that this is the malformation (atresia)"
    ),
    "opening-too-large": (
        "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near "
        "{place} mm, at {by}[, which asks for {asked#} mm²]: the wall around the defect may be missing as well"
    ),
    "opening-stated": (
        "{one} and {other} are open to each other over {area#} mm²[ in {patches#} patches, the largest] near "
        "{place} mm, as stated by {by}[, which asks for {asked#} mm²]"
    ),
    "compartments-joined": (
        "the blood of {one} and of {other}: apart in the segmentation, but joined {where} where the outlines are "
        "smoothed; paint a stroke of background, or of the muscle, between them, or take a smaller "
        "walls.smoothing_mm"
    ),
    "parts-joined": (
        "two parts of the blood of {one}: apart in the segmentation, but joined {where} where the outlines are "
        "smoothed; paint a stroke of background, or of the muscle, between them, or take a smaller "
        "walls.smoothing_mm"
    ),
    "compartments-split": (
        "the blood of {one}[ and of {other}]: in one piece in the segmentation, but cut in two {where} where the "
        "passage is narrow; widen it there with a stroke, or take a smaller walls.smoothing_mm"
    ),
    "cavity-cut-by-septum": (
        "{label}: cut in two by a grown septum {where}, where it is narrow and lies along another cavity; give "
        "the pair a smaller thickness_mm in [[walls.septum]], or paint the wall between the two"
    ),
    "gap-stated": "{label}: open to the outside {where}, as its table of thicknesses says",
    "wall-gap": (
        "{label}: its wall has a gap {where}, so it is open to the outside there; if a vessel is cut off there, "
        "mark it (an entry of 'ends'), else look at the segmentation there"
    ),
    "vessel-open-to-outside": (
        "{label}: its blood is open to the outside {where}, with neither muscle nor a wall between; if it is cut "
        "off there, mark it (an entry of 'ends'), else paint the muscle that is missing there and background "
        "beyond it, or, where the scan does not show so thin a wall, give the label a wall_thickness_mm: a wall "
        "grows only where no muscle is"
    ),
    "open-to-outside": (
        "{label}: its blood is open to the outside {where}, with neither muscle nor a wall between; paint the "
        "muscle that is missing there and background beyond it, or, where the scan does not show so thin a wall, "
        "give the label a wall_thickness_mm: a wall grows only where no muscle is"
    ),
    "adult-walls": (
        "walls as thick as an adult's are grown around the heart of a child: by its ventricles its body has a surface "
        "of about {area#} m². In brackets what fits it: {listed}. Give the labels their wall_thickness_mm"
    ),
    "more-places": "and {rest#} more places like the last, which are smaller",
    "long-voxels": (
        "the scan's voxels are {times#} times as long as wide ({shortest#} and {longest#} mm), so the shape "
        "between its slices is a guess: walls, openings and vessels that are thinner than {longest#} mm may be "
        "lost or made up; take a scan with voxels that are nearly cubes where there is one"
    ),
    "heart-cut-off-by-region": (
        "the heart is cut off at {face}, without an end marker: {listed}. What lies beyond is missing from the "
        "model, its volumes and its pictures: enlarge the region of interest there; where the scan ends there "
        "too, take one that holds the whole heart"
    ),
    "heart-cut-off": (
        "the heart is cut off at {face}, without an end marker: {listed}. What lies beyond is missing from the "
        "model, its volumes and its pictures: take a scan that holds the whole heart"
    ),
    "vessel-cut-lengthwise": "{face} cuts along {listed}, not across: look how much of it is missing beyond",
    "vessel-open-at-face": "open where they leave through {face}: {listed}",
    "smoothed-away": (
        "{label}: vanished in the smoothing of the outlines, as it is too thin for it; take a smaller "
        "walls.smoothing_mm"
    ),
    "smoothed-smaller": (
        "{label}: the smoothing takes {percent#}% of its volume, as it is small; take a smaller walls.smoothing_mm"
    ),
    "smoothed-narrower": (
        "{label}: the smoothing of the outlines narrows it near {place} mm from {before#} mm to {after#} mm; take"
        " a smaller walls.smoothing_mm"
    ),
    "smoothed-shut": (
        "{label}: the smoothing of the outlines narrows it near {place} mm from {before#} mm until it is closed; "
        "take a smaller walls.smoothing_mm"
    ),
    "closed-sac": (
        "the {label} ends in a closed sac, as no vessel does: mark where it is cut off (an entry of 'ends' in the"
        " recipe; heartcase suggest --ends proposes one)"
    ),
    "end-moved": (
        "the disc did not cut the vessel through, so it was moved by {mm#} mm onto it, turned by {degrees#} "
        "degrees[ and its radius set to {radius#} mm]: look whether that is the vessel you mean, then write "
        "{numbers}"
    ),
    "end-continued": (
        "the segmented vessel stops {mm#} mm before this end marker and was continued straight to it: if that is "
        "wrong, move the marker, or add a stroke to the vessel"
    ),
    "end-shut": "other structures close the vessel at this end marker: move the marker towards the heart",
    "end-cuts-heart": ("more of it is cut off than stays, with what a chamber touches: turn its axis out of the heart"),
    "hanging-tissue": (
        "{count#} <part|parts> of the tissue <hangs|hang> on the rest by an edge or a corner only and can swing "
        "freely, at {places}: make the cells smaller, or hold the tissue there ([[pins]])"
    ),
    "loose-tissue": (
        "{count#} <part|parts> of the tissue <is|are> loose in the simulation, but joined to the rest in the "
        "scan, at {places}: make the cells smaller"
    ),
    "wall-with-hole": (
        "a wall that is much thinner than a simulation cell has a hole in the simulation, not in the scan, at "
        "{places}: make the cells smaller"
    ),
    "opening-shut": (
        "{count#} <opening|openings> about as narrow as a simulation cell <is|are> closed in the simulation, not "
        "in the scan, at {places}: make the cells smaller where such an opening matters"
    ),
    "tissue-apart": (
        "the tissue is in {count#} separate <piece|pieces> at the scan's resolution but in {now#} in the "
        "simulation cells: what belongs together is apart, at {places}; make the cells smaller"
    ),
    "tissue-joined": (
        "the tissue is in {count#} separate <piece|pieces> at the scan's resolution but in {now#} in the "
        "simulation cells: separate parts were joined or lost, at {places}; make the cells smaller"
    ),
    "blood-apart": (
        "the blood is in {count#} separate <piece|pieces> at the scan's resolution but in {now#} in the "
        "simulation cells: what belongs together is apart, at {places}; make the cells smaller"
    ),
    "blood-joined": (
        "the blood is in {count#} separate <piece|pieces> at the scan's resolution but in {now#} in the "
        "simulation cells: separate parts were joined or lost, at {places}; make the cells smaller"
    ),
    "small-gaps-chambers-kept": (
        "the simulation does not keep the smallest gaps and strands of the tissue, which are about as small as "
        "one of its cells ({cell#} mm): {count#} <place|places>, {places}; the chambers and the passages between "
        "them are as in the scan. Nothing need be done; only where something so small matters, make the cells "
        "smaller"
    ),
    "small-gaps": (
        "the simulation does not keep the smallest gaps and strands of the tissue, which are about as small as "
        "one of its cells ({cell#} mm): {count#} <place|places>, {places}. Nothing need be done; only where "
        "something so small matters, make the cells smaller"
    ),
    "floating-tissue": (
        "{count#} <piece|pieces> of tissue ({cells}) <is|are> attached to nothing that is held still and can "
        "drift away; <it|the largest> is at {place} mm: hold it there ([[pins]]) or remove it"
    ),
    "surface-too-narrow": (
        "{percent#}% of the visible surface lies where a cavity or a wall is too narrow for the simulation cells,"
        " and moves with what is nearest to it instead (most of it near {place} mm): make the cells smaller if "
        "that place matters"
    ),
    "specks": (
        "{bits#} tiny loose bits of tissue or hollows in it, {total#} mm3 together and none above {most#} mm3, "
        "are not shown: nothing need be done unless something that small matters"
    ),
    "scan-too-large": "the scan is too large to show its thinnest walls in full detail: make the \\[region\\] smaller",
    "surface-error": (
        "with {triangles#} triangles 1% of the visible surface is {off#} mm or more off its full resolution, not "
        "{asked#} mm: allow more with surface.triangle_count"
    ),
    "level-left-out": (
        "the level of detail with {triangles#} triangles is left out, as thin walls would pass through each other"
        " with so few: nothing need be done unless a slow display needs it"
    ),
    "surface-gaps": (
        "the visible surface has gaps or overlaps at {gaps#} places and may not cut cleanly: ask for more triangles"
    ),
    "surface-folded": (
        "{bad#} of the surface's {triangles#} triangles are folded over and may show as dark spots: ask for more "
        "triangles if they disturb"
    ),
    "surface-crossing": (
        "the visible surface passes through itself at {pairs#} pairs of triangles and may not cut or print "
        "cleanly there: ask for more triangles"
    ),
    "surface-more-triangles": (
        "the surface has {triangles#} triangles instead of the {asked#} asked for, as fewer would break its "
        "shape: nothing need be done unless the display is slow"
    ),
    "table-unused": "{label}: its wall is segmented, so its table of thicknesses has no effect",
    "table-outside": (
        "{label}: no point of its table of thicknesses lies in the scan: give the points in LPS mm (programs that"
        " show RAS have x and y of the opposite sign)"
    ),
}
"""Kind of warning -> its sentence, as :class:`heartcase.pipeline.warnings.CaseWarning` has it."""

_TOKEN = re.compile(r"\{(\w+)(#?)\}|<([^<>|]*)\|([^<>|]*)>|\[\[|\]\]|\\\[|\\\]|\[|\]")
_BRACKETS = {"[[": "[[", "]]": "]]", "\\[": "[", "\\]": "]"}
_NUMBER = r"-?[\d.,]+(?:e[+-]?\d+)?"


class Recognised(NamedTuple):
    """What a sentence says."""

    kind: str
    """Kind of the warning, a key of :data:`SENTENCES`; empty for a sentence that is none of them."""
    values: dict[str, str]
    """Its values, as they stand in the sentence."""


def sentence(kind: str, **values: object) -> str:
    """The sentence of a warning.

    Parameters
    ----------
    kind
        A key of :data:`SENTENCES`.
    values
        Its values, as they are to be read; None leaves out what stands around an optional one.

    Raises
    ------
    KeyError
        There is no such kind, or a value is missing.
    """
    said = {name: str(value) for name, value in values.items() if value is not None}
    parts, _ = _said(list(_tokens(SENTENCES[kind])), 0, said)
    return parts


def recognised(text: str) -> Recognised:
    """Kind and values of a sentence that :func:`sentence` made; what it is about may stand before it: ``ends[2]: ...``.

    That is the value ``about`` then.
    """
    about, found = "", _matched(text)
    if found is None:
        about, _, rest = text.partition(": ")
        found = _matched(rest)
    if found is None:
        return Recognised("", {})
    return Recognised(found.kind, found.values | ({"about": about} if about else {}))


def _matched(text: str) -> Recognised | None:
    for kind, pattern in _patterns().items():
        found = pattern.fullmatch(text)
        if found is not None:
            return Recognised(kind, {name: value for name, value in found.groupdict().items() if value is not None})
    return None


def value_names(template: str) -> frozenset[str]:
    """Names of the values of a template."""
    return frozenset(found[1] for found in _TOKEN.finditer(template) if found[1])


def _tokens(template: str) -> list[str | re.Match[str]]:
    """Plain text, and what stands for something."""
    found: list[str | re.Match[str]] = []
    at = 0
    for token in _TOKEN.finditer(template):
        found += [template[at : token.start()], token]
        at = token.end()
    return [*found, template[at:]]


def _said(tokens: list[str | re.Match[str]], at: int, values: Mapping[str, str]) -> tuple[str, int]:
    """What the tokens say from one on, up to the end of their optional part, and where that is."""
    said = ""
    while at < len(tokens):
        token = tokens[at]
        at += 1
        if isinstance(token, str):
            said += token
        elif token[0] in _BRACKETS:
            said += _BRACKETS[token[0]]
        elif token[0] == "[":
            try:
                inner, at = _said(tokens, at, values)
                said += inner
            except KeyError:
                at = next(n for n in range(at, len(tokens)) if _is_end(tokens[n])) + 1
        elif token[0] == "]":
            return said, at
        elif token[1]:
            said += values[token[1]]
        else:
            said += token[3] if values["count"] == "1" else token[4]
    return said, at


def _is_end(token: str | re.Match[str]) -> bool:
    return not isinstance(token, str) and token[0] == "]"


@cache
def _patterns() -> dict[str, re.Pattern[str]]:
    return {kind: re.compile(_pattern(template), re.DOTALL) for kind, template in SENTENCES.items()}


def _pattern(template: str) -> str:
    pattern, seen = "", set()
    for token in _tokens(template):
        if isinstance(token, str):
            pattern += re.escape(token)
        elif token[0] in _BRACKETS:
            pattern += re.escape(_BRACKETS[token[0]])
        elif token[0] in "[]":
            pattern += "(?:" if token[0] == "[" else ")?"
        elif token[1] and token[1] in seen:
            pattern += f"(?P={token[1]})"
        elif token[1]:
            seen.add(token[1])
            pattern += f"(?P<{token[1]}>{_NUMBER if token[2] else '.+?'})"
        else:
            pattern += f"(?:{re.escape(token[3])}|{re.escape(token[4])})"
    return pattern
