"""The messages of a session by their kind, so that a page says them in its own language.

A message is raised and told as English text, wherever it comes from. What it says is found again by a template, which
is that text: ``{name}`` stands for a value in words, ``{name#}`` for a number, ``{name*}`` for words that may be of a
kind themselves. The first that fits is taken. A text that none of them fits has no kind, and is shown as it is.
``studio/page/words/messages_de.js`` has the German sentences.
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
    "recording-broke": "{why*}; the recording ended with what was done by then",
    "recording-unwritable": "cannot be written: {why}",
    "recording-already": "it is recorded already",
    "recording-unknown": "there is no recording of this name: look at the list again",
    "recording-busy": "it is being recorded: end the recording first",
    "recording-name-taken": "there is already a recording of this name: choose another",
    "recording-name": (
        "a name begins with a letter, a digit or _, and has no more than 80 of these, spaces and ( ) + , -: "
        "choose another"
    ),
    "recording-not-renamed": "it cannot be renamed: {why}",
    "recording-path-taken": "there is something at this path already: take another name",
    "recording-no-folder": "the folder of this path does not exist: make it first",
    "inside-case": (
        "this is the folder of a case, or lies in one, where nothing but the case's own files may be: choose another "
        "place"
    ),
    "recording-unwritten": "what was done cannot be written",
    "session-stuck": "the session does not end: what was done cannot be written",
    "history-lost": "what was done earlier cannot be read any more: begin anew",
    "recording-not-whole": "it is not whole: the first {seconds#} s are shown",
    "recording-gone": "there is nothing at this path: check its spelling",
    "recording-no-header": "this is not a recording: it holds no recording.json",
    "recording-foreign": (
        "does not say that it is a heartcase-recording: name a folder that heartcase record, or a session, wrote"
    ),
    "recording-newer": "this recording is of a newer version than this heartcase reads: {get*}",
    "newer-any": "get a newer heartcase",
    "newer-one": "get heartcase {version}, which recorded it, or a newer one",
    "recording-too-large": "is too large and was not read: the recording is damaged",
    "recording-no-json": "cannot be read as JSON: the recording is damaged",
    "recording-log-unread": "cannot be read",
    "state-missing": "the state of step {step#} is missing: the recording is damaged",
    "state-damaged": "the state of step {step#} is damaged: it is not what was recorded",
    "state-unfit": "a stored state does not fit the lattice or is damaged",
    "state-other-step": "its first state is of another step: the recording is damaged",
    "recording-damaged": "{why}: the recording is damaged",
    "recording-entry": "what entry {entry#} joins or cuts cannot be: {why*}",
    "recording-other-case": (
        "this recording is of the case {of} with {count#} nodes, and the case given is not the same ({nodes#} nodes): "
        "give the case that was recorded, not built anew in another way"
    ),
    "recording-tissue": (
        "this recording cuts tissue that {where}, and other tissue was given: load the case with needs=('tissue',) "
        "and give Case.tissue, or leave it out"
    ),
    "recording-no-start": "its first state is missing: nothing can be repeated",
    "recording-backend": "there is no backend {name} in this heartcase",
    "recording-law": "the force law has settings that this heartcase does not know",
    "recording-law-unknown": "there is no force law {name}: choose from {known}",
    "recording-step": (
        "a step of {step#} s is not stable: this case's bound is {most#} s; give at most that, or leave it out for "
        "{own#} s"
    ),
    "recording-pace": (
        "at a pace of {pace#} steps are {step#} s, and this case's bound is {most#} s: give at most {less#}"
    ),
    "no-gpu": "there is no CUDA device: {remedy}",
    "no-cuda": "numba cannot load CUDA ({why}): {remedy}",
    "replay-differs": (
        "the replay is not what was recorded: from step {step#} on it differs, by up to {first#} mm there and {most#} "
        "mm in all; another heartcase or another kind of processor recorded it"
    ),
    "step-unknown": "step {step#} is not known: there are {first#} to {last#}",
    "branch-gone": "there is no such branch any more: look at the list again",
    "kept": "what was done is kept in the recording {name}",
    "kept-not": "what was done is not kept: {why}",
    "case-freed": "no page had this case open for {minutes#} minutes, and it was closed: this is its beginning",
    "case-freed-kept": (
        "no page had this case open for {minutes#} minutes, and it was closed: this is its beginning; what was done "
        "is kept in the recording {name}: replay it to go on"
    ),
    "case-older": "the case was built anew, and what is shown is the one before: begin anew to see the new one",
    "case-new-and": (
        "the case was built anew: this is the new one, and the session on the one before has ended; {words*}"
    ),
    "case-new": "the case was built anew: this is the new one, and the session on the one before has ended",
    "case-not-open": "the case is not open",
    "nothing-to-undo": "there is nothing to take back",
    "nothing-to-redo": "there is nothing to do again",
    "nothing-cut": "nothing is cut in it: there is no incision",
    "nothing-to-go-on": "there is no stroke to go on with: begin one",
    "excise-nothing-cut": "nothing is cut: cut a piece free first",
    "excise-again": "this piece was taken out already",
    "excise-not-free": "what is here hangs together with the rest of the heart: cut around it on all sides first",
    "excise-held": "this piece is held by {names}: let go of it first",
    "cut-nothing": "there is no tissue in its way: look where the line lies and how deep it goes",
    "cut-too-far": (
        "the blade reaches too far: at half a cell apart it has {wide#} x {high#} places; give it near the tissue alone"
    ),
    "cut-outside": "every point must lie within the lattice or near it",
    "cut-open-surface": "the surface is not closed: only a closed one can be cut",
    "grab-nothing": (
        "there is no tissue within {radius#} mm of the grab; the nearest is {far#} mm from its centre: move it there "
        "or give a larger radius"
    ),
    "grab-fixed": "all the tissue in the grab is fixed: grab elsewhere",
    "grab-held": "another hand holds all the tissue in the grab: grab elsewhere",
    "hand-gone": "no hand of this name holds tissue: close it first",
    "probe-gone": "there is no probe of this name: bring it in first",
    "probe-small": "give a radius or three semi-axes of at least half a cell, {least#} mm",
    "name-in-use": "an instrument of this name is in the tissue: take another name",
    "scissors-gone": "there are no scissors of this name: bring them in first",
    "forceps-gone": "no forceps of this name hold tissue: close them first",
    "forceps-nothing": "there is no tissue between the jaws: move them there, or open them further",
    "forceps-fixed": "all the tissue between the jaws is fixed: take hold elsewhere",
    "forceps-held": "other hands hold all the tissue between the jaws: take hold elsewhere",
    "forceps-along": "the jaws close along their own length: give another closing direction",
    "retractor-nothing": (
        "there is no tissue within {depth#} mm of the line on that side: move the line there, or turn the side round"
    ),
    "retractor-fixed": "all the tissue beside the line is fixed or held: take hold elsewhere",
    "retractor-line": "the line needs two points or more, of three finite numbers, not all the same",
    "stitch-nothing": (
        "there is no tissue within {reach#} mm of this place; the nearest is {far#} mm away: give one on the tissue"
    ),
    "stitch-far": "there is no tissue within {reach#} mm of this place; the surface is {far#} mm away: give one on it",
    "stitch-fixed": "both places are in tissue that is held for good: nothing would move",
    "stitch-tied": "the stitch is tied: take it out and place another",
    "stitch-gone": "there is no stitch of this name: place it first",
    "stitch-name-in-use": "there is a stitch of this name: take another name",
    "row-name-in-use": "there is a stitch or a row of this name: take another name",
    "thread-stiff": (
        "a thread of {given#} N/m is stiffer than the time step allows here: give {most#} N/m or less, or a smaller "
        "step"
    ),
    "thread-no-room": "other springs and threads leave this one nothing: give a smaller step",
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
    "patch-gone": "there is no patch of this name: sew it on first",
    "patch-name-in-use": "there is a patch of this name: take another name",
    "patch-no-room": "the time step leaves nothing for a patch: give a smaller step",
    "open-no-cut": "there is no such incision: cut first",
    "open-already": "this cut is held open already: let all go first",
    "open-no-line": "this cut has no line on the tissue: hold it open by hand",
    "session-silent": "the session does not answer: begin anew",
    "device-already": "a device leads a hand already: stop it first",
    "device-nowhere": "the heart is not in the middle of the picture: turn it there first",
    "device-unknown": "there is no haptic device {name}: choose from {known}",
    "device-fault": "it failed with {error}",
    "device-failed": "the haptic device {name} failed with {error}: {words}",
    "device-wrong": "the haptic device {name} {words}: its driver is to be mended",
    "device-killed": "it was killed",
    "device-slow": "it did not start within a minute",
    "device-early": "it ended before it had begun",
    "haptics-none": "the haptic loop cannot run: {why*}",
    "haptics-ended": "the haptic loop has ended: {why*}; make another",
    "device-lost": "{why*}; its hand lets go softly",
    "figures-ended": "what works out figures has ended: hide and show them again",
    "plans-ended": "what works out figures has ended: compare again",
    "page-ended": "what saves the page has ended: save it again",
    "page-unwritable": "it cannot be written: {why}",
    "no-scan": "the case holds no scan, and its recipe is not known: open the case from its recipe",
    "scan-unread": "the recipe's scan cannot be read: open the recipe, it says why",
    "scan-other": ("the recipe's scan or its region is no longer what the case was built from: build the case again"),
    "tour-gone": "there is no tour of this number: look at the list again",
    "tour-short": "the tour has {count#} steps",
    "recipe-changed": "another program changed the recipe: it was opened again, so look before you go on",
    "recipe-changed-and-lost": (
        "another program changed the recipe: it was opened again, and the last stroke, which was not saved yet, is "
        "lost; look before you go on"
    ),
    "recipe-spoilt": (
        "another program changed the recipe, and it cannot be opened any more: mend it, then load this page again"
    ),
    "recipe-spoilt-and-lost": (
        "another program changed the recipe, and it cannot be opened any more; the last stroke, which was not saved "
        "yet, is lost: mend the recipe, then load this page again"
    ),
    "trouble-number": "a position is not a number any more",
    "trouble-energy": "its energy grew from {from#} J to {to#} J by itself",
    "trouble-held": "{trouble*} with {names} in the tissue",
    "broke-down": (
        "the simulation broke down between {from#} s and {to#} s: {trouble*}; pull more slowly or less far, or give a "
        "smaller step. The state before was restored"
    ),
}
"""Kind -> what is said, in English."""

_TOKEN = re.compile(r"\{(\w+)([#*]?)\}")
_NUMBER = r"-?[\d.,]+(?:e[+-]?\d+)?"


def problem_facts(place: str, message: str) -> dict[str, Any]:
    """A problem as a page is told it: place and text, with kind and values (``code``, ``values``) where it has some.

    A value is text; words that are of a kind themselves are told as their own ``message``, ``code`` and ``values``.
    """
    return {"place": place} | _told(message)


def value_names(template: str) -> frozenset[str]:
    """Names of the values of a template."""
    return frozenset(found[1] for found in _TOKEN.finditer(template))


def _told(text: str) -> dict[str, Any]:
    for code, pattern in _patterns().items():
        if (found := pattern.fullmatch(text)) is not None:
            values: dict[str, Any] = found.groupdict()
            for token in _TOKEN.finditer(MESSAGES[code]):
                if token[2] == "*" and "code" in (inner := _told(values[token[1]])):
                    values[token[1]] = inner
            return {"message": text, "code": code, "values": values}
    return {"message": text}


@cache
def _patterns() -> dict[str, re.Pattern[str]]:
    return {code: re.compile(_pattern(template), re.DOTALL) for code, template in MESSAGES.items()}


def _pattern(template: str) -> str:
    pattern, at = "", 0
    for token in _TOKEN.finditer(template):
        value = _NUMBER if token[2] == "#" else ".+?"
        pattern += f"{re.escape(template[at : token.start()])}(?P<{token[1]}>{value})"
        at = token.end()
    return pattern + re.escape(template[at:])
