"""The messages of a session by their kind, so that a page says them in its own language.

A message is raised and told as English text, wherever it comes from. What it says is found again by a template:
``{name}`` stands for a value in words, ``{name#}`` for a number. A text that none of them fits has no kind, and is
shown as it is. ``studio/page/words/messages_de.js`` has the German sentences.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from typing import Any

__all__ = ["MESSAGES", "problem_facts", "value_names"]

MESSAGES: Mapping[str, str] = {
    "recording-begun": "recording into {name}",
    "recording-done": "recorded in {name}",
    "recording-broke": "cannot be written: {why}; the recording ended with what was done by then",
    "recording-already": "it is recorded already",
    "recording-unknown": "there is no recording of this name: look at the list again",
    "recording-busy": "it is being recorded: end the recording first",
    "recording-name-taken": "there is already a recording of this name: choose another",
    "recording-unwritten": "what was done cannot be written",
    "recording-not-whole": "it is not whole: the first {seconds#} s are shown",
    "recording-other-case": (
        "this recording is of the case {of} with {count#} nodes, and the case given is not the same ({nodes#} nodes): "
        "give the case that was recorded, not built anew in another way"
    ),
    "recording-no-start": "its first state is missing: nothing can be repeated",
    "replay-differs": (
        "the replay is not what was recorded: from step {step#} on it differs, by up to {first#} mm there and {most#} "
        "mm in all; another heartcase or another kind of processor recorded it"
    ),
    "kept": "what was done is kept in the recording {name}",
    "kept-not": "what was done is not kept: {why}",
    "case-freed": "no page had this case open for {minutes#} minutes, and it was closed: this is its beginning",
    "case-freed-kept": (
        "no page had this case open for {minutes#} minutes, and it was closed: this is its beginning; what was done is "
        "kept in the recording {name}: replay it to go on"
    ),
    "case-older": ("the case was built anew, and what is shown is the one before: begin anew to see the new one"),
    "case-new-kept": (
        "the case was built anew: this is the new one, and the session on the one before has ended; what was done is "
        "kept in the recording {name}"
    ),
    "case-new": "the case was built anew: this is the new one, and the session on the one before has ended",
    "case-not-open": "the case is not open",
    "nothing-to-undo": "there is nothing to take back",
    "nothing-to-redo": "there is nothing to do again",
    "nothing-cut": "nothing is cut in it: there is no incision",
    "nothing-to-go-on": "there is no stroke to go on with: begin one",
    "excise-nothing-cut": "nothing is cut: cut a piece free first",
    "excise-again": "this piece was taken out already",
    "excise-not-free": ("what is here hangs together with the rest of the heart: cut around it on all sides first"),
    "excise-held": "this piece is held by {names}: let go of it first",
    "cut-nothing": "there is no tissue in its way: look where the line lies and how deep it goes",
    "cut-too-far": (
        "the blade reaches too far: at half a cell apart it has {wide#} x {high#} places; give it near the tissue alone"
    ),
    "grab-nothing": (
        "there is no tissue within {radius#} mm of the grab; the nearest is {far#} mm from its centre: move it there "
        "or give a larger radius"
    ),
    "grab-fixed": "all the tissue in the grab is fixed: grab elsewhere",
    "grab-held": "another hand holds all the tissue in the grab: grab elsewhere",
    "hand-gone": "no hand of this name holds tissue: close it first",
    "probe-gone": "there is no probe of this name: bring it in first",
    "scissors-gone": "there are no scissors of this name: bring them in first",
    "forceps-gone": "no forceps of this name hold tissue: close them first",
    "forceps-nothing": "there is no tissue between the jaws: move them there, or open them further",
    "forceps-fixed": "all the tissue between the jaws is fixed: take hold elsewhere",
    "forceps-held": "other hands hold all the tissue between the jaws: take hold elsewhere",
    "retractor-nothing": (
        "there is no tissue within {depth#} mm of the line on that side: move the line there, or turn the side round"
    ),
    "retractor-fixed": "all the tissue beside the line is fixed or held: take hold elsewhere",
    "retractor-line": "the line needs two points or more, of three finite numbers, not all the same",
    "stitch-nothing": (
        "there is no tissue within {reach#} mm of this place; the nearest is {far#} mm away: give one on the tissue"
    ),
    "stitch-far": (
        "there is no tissue within {reach#} mm of this place; the surface is {far#} mm away: give one on it"
    ),
    "stitch-fixed": "both places are in tissue that is held for good: nothing would move",
    "stitch-tied": "the stitch is tied: take it out and place another",
    "stitch-gone": "there is no stitch of this name: place it first",
    "row-full": "all stitches of this row are there already: space them closer",
    "row-too-many": "this row would have {count#} stitches; {most#} are the most: space them wider",
    "patch-crosses": "the outline crosses itself, or two of its stitches are in one place: draw a simple loop",
    "patch-not-flat": "the sheet over this outline cannot be laid out flat: draw a flatter loop",
    "patch-no-area": "the outline encloses no area: draw a loop",
    "patch-narrow": (
        "the outline is too narrow somewhere for so few stitches: give a smaller spacing_mm, or a rounder outline"
    ),
    "patch-too-many": "this rim would have {count#} stitches; {most#} are the most: space them wider",
    "patch-outline": "an outline has at least three points of three finite numbers",
    "open-no-cut": "there is no such incision: cut first",
    "open-already": "this cut is held open already: let all go first",
    "open-no-line": "this cut has no line on the tissue: hold it open by hand",
    "session-silent": "the session does not answer: begin anew",
    "device-already": "a device leads a hand already: stop it first",
    "device-nowhere": "the heart is not in the middle of the picture: turn it there first",
    "figures-ended": "what works out figures has ended: hide and show them again",
    "plans-ended": "what works out figures has ended: compare again",
    "page-ended": "what saves the page has ended: save it again",
    "broke-down": (
        "the simulation broke down between {from#} s and {to#} s: {trouble}; pull more slowly or less far, or give a "
        "smaller step. The state before was restored"
    ),
}
"""Kind -> what is said, in English."""

_TOKEN = re.compile(r"\{(\w+)(#?)\}")
_NUMBER = r"-?[\d.,]+(?:e[+-]?\d+)?"


def problem_facts(place: str, message: str) -> dict[str, Any]:
    """A problem as a page is told it: place and text, with kind and values (``code``, ``values``) where it has some."""
    return {"place": place, "message": message} | _recognised(message)


def value_names(template: str) -> frozenset[str]:
    """Names of the values of a template."""
    return frozenset(found[1] for found in _TOKEN.finditer(template))


def _recognised(text: str) -> dict[str, Any]:
    for code, pattern in _patterns().items():
        if (found := pattern.fullmatch(text)) is not None:
            return {"code": code, "values": found.groupdict()}
    return {}


@cache
def _patterns() -> dict[str, re.Pattern[str]]:
    return {code: re.compile(_pattern(template), re.DOTALL) for code, template in MESSAGES.items()}


def _pattern(template: str) -> str:
    pattern, at = "", 0
    for token in _TOKEN.finditer(template):
        value = _NUMBER if token[2] else ".+?"
        pattern += f"{re.escape(template[at : token.start()])}(?P<{token[1]}>{value})"
        at = token.end()
    return pattern + re.escape(template[at:])
