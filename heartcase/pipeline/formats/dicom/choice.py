"""List what a DICOM folder holds, and choose one stack of it.

A series is named by its number in the list and a hash of its UID: a tag's text, and a UID, may identify a patient.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from heartcase.pipeline.formats.dicom.compare import measured_words
from heartcase.pipeline.formats.dicom.headers import OTHER_MODALITIES
from heartcase.pipeline.formats.dicom.phases import PhaseStack, StackGroup
from heartcase.pipeline.formats.dicom.stack import Stack, find_stack
from heartcase.pipeline.formats.volumes.nearest_time import listed_times, nearest_time
from heartcase.pipeline.formats.volumes.raw_volume import geometry_from_affine
from heartcase.pipeline.warnings import note
from heartcase.schemas.errors import Problem, ScanError
from heartcase.schemas.geometry import Geometry

__all__ = ["Choice", "SeriesInfo", "choose", "describe_volume", "lack_problem", "listed", "named", "stack_geometry"]

SHORTEST_CODE = 6
SHORTEST_STACK_CODE = 2
ALIKE_IN_PHASES = ("image_kind", "sequence", "b_value", "inversion_time_ms", "tube_voltage_kv")
"""What cardiac phases that are series of their own must state alike."""
SMALL_STACK = 9
"""Images that a localiser has at most, where the headers do not call it one."""
SMALL_PART = 0.25
"""Part of the largest stack's images that a localiser has at most, where the headers do not call it one."""
GEOMETRY_TOLERANCE_MM = 0.01
"""Cardiac phases that are series of their own lie at one place to this."""
LACKS_NAMED = 5
"""How many slice positions without an image an error names."""


@dataclass(frozen=True)
class SeriesInfo:
    """A series, or one of its stacks, as it may be shown: nothing in it tells who was scanned."""

    number: int
    """Number to choose it by, from 1."""
    slice_count: int
    """Number of images, those of all cardiac phases and echoes together."""
    spacing_mm: tuple[float, float, float] | None
    """Spacing along i, j, k; None where the images do not form one stack."""
    modality: str
    """``CT``, ``MR``, a kind of image that is not read (``PT``, ``US`` ...), or ``unknown``."""
    description: str
    """What it is, in words made from geometry, modality and physics."""
    uid_code: str
    """The start of the SHA-256 of its UID: six hexadecimal digits, or more until it differs from the others' and is no
    number. Where the series holds several stacks, two digits or more of the stack's own follow after a hyphen. Empty
    for other formats."""
    trigger_times_ms: tuple[float, ...] = ()
    """Times of the cardiac phases after the R wave, ms, ascending; empty where none is stated."""
    echo_times_ms: tuple[float, ...] = ()
    """Echo times, ms, ascending; empty where none is stated."""
    scanner_number: int | None = None
    """Number of its series on the scanner, where it is stated: it orders the list, but chooses nothing."""
    is_phase: bool = False
    """Whether it is one cardiac phase of several that are series of their own: a trigger time chooses it too."""

    @property
    def has_choice(self) -> bool:
        """Whether a time is needed to choose one stack of it."""
        return max(len(self.trigger_times_ms), len(self.echo_times_ms)) > 1


class Choice(NamedTuple):
    """One stack of a folder."""

    group: StackGroup
    """What its number stands for."""
    stack: PhaseStack
    """Its images."""
    notes: tuple[str, ...] = ()
    """What a reader should know of how it was chosen."""


def describe_volume(geometry: Geometry, modality: str) -> str:
    """What a volume is, in words: modality, orientation, size and spacing."""
    normal = np.abs(geometry.direction_matrix[:, 2])
    plane = ("sagittal", "coronal", "axial")[int(np.argmax(normal))]
    if normal.max() < 0.999:
        plane = f"oblique {plane}"
    size = " x ".join(str(count) for count in geometry.size)
    spacing = " x ".join(f"{length:.4g}" for length in geometry.spacing_mm)
    return f"{modality if modality != 'unknown' else 'volume'}, {plane}, {size} voxels of {spacing} mm"


def stack_geometry(stack: Stack) -> Geometry:
    """Where the voxels of a stack lie that needs no straightening."""
    rows, columns = stack.slices[0].shape
    return geometry_from_affine(stack.affine, (stack.places[-1] + 1, rows, columns))


def listed(groups: Sequence[StackGroup]) -> tuple[SeriesInfo, ...]:
    """What the user may choose from, in order."""
    described = [_described(group) for group in groups]
    measured = measured_words(groups, [description for _, description in described])
    words = [description + more for (_, description), more in zip(described, measured, strict=True)]
    repeated = Counter(words)
    words = [one + _apart_words(group) if repeated[one] > 1 else one for group, one in zip(groups, words, strict=True)]
    candidates = _candidates(groups) if groups else []
    phases = candidates if len(candidates) > 1 and _time_option(candidates) == "--trigger-time" else []
    found = []
    for number, (group, code) in enumerate(zip(groups, _codes(groups), strict=True), start=1):
        triggers, echoes = _times(group.stacks)
        found.append(
            SeriesInfo(
                number=number,
                slice_count=group.image_count,
                spacing_mm=described[number - 1][0],
                modality=group.modality,
                description=words[number - 1],
                uid_code=code,
                trigger_times_ms=triggers,
                echo_times_ms=echoes,
                scanner_number=group.scanner_number,
                is_phase=any(group is one for one in phases),
            )
        )
    return tuple(found)


def _apart_words(group: StackGroup) -> str:
    """What tells a group from one that is described alike: its time, and its number on the scanner."""
    triggers, _ = _times(group.stacks)
    time = f", trigger time {triggers[0]:g} ms" if len(triggers) == 1 else ""
    return time + (f", series {group.scanner_number} on the scanner" if group.scanner_number is not None else "")


def _time_option(groups: Sequence[StackGroup]) -> str:
    """The option that chooses one of groups which are one stack each, alike in all but a time; empty if none does."""
    if not _are_phases(groups):
        return ""
    triggers = {group.stacks[0].trigger_time_ms for group in groups}
    echoes = {group.stacks[0].echo_time_ms for group in groups}
    if None not in triggers and len(triggers) == len(groups):
        return "--trigger-time"
    return "--echo-time" if None not in echoes and len(echoes) == len(groups) else ""


def _described(group: StackGroup) -> tuple[tuple[float, float, float] | None, str]:
    spacing = None
    noun = group.modality if group.modality != "unknown" else "images"
    if group.modality in OTHER_MODALITIES:
        return None, f"{noun}, not read: CT and MR are"
    try:
        geometry = stack_geometry(find_stack(group.stacks[0].slices))
        spacing, description = geometry.spacing_mm, describe_volume(geometry, group.modality)
    except ScanError as error:
        description = f"{noun}, not one even stack ({error.problems[0].message.partition(':')[0]})"
    triggers, echoes = _times(group.stacks)
    if group.kind:
        description += f", {group.kind}"
    if len(echoes) > 1:
        description += f", {len(echoes)} echoes of {echoes[0]:g} to {echoes[-1]:g} ms"
    elif echoes and "echo time" not in description:
        description += f", echo time {echoes[0]:g} ms"
    partial = _partial_count(group.stacks)
    if len(triggers) > 1 or partial:
        phases = f"{len(triggers)} cardiac phase{'s' * (len(triggers) != 1)}"
        description += f", {phases} at {triggers[0]:g} to {triggers[-1]:g} ms" if triggers else ", no cardiac phase"
        description += f" at every slice position and {partial} at some of them" if partial else ""
    elif group.is_localizer and "localiser" not in description:
        description += ", localiser"
    return spacing, description


def _partial_count(stacks: Sequence[PhaseStack]) -> int:
    """Number of cardiac phases that some slice positions have no image of."""
    return sum(bool(stack.lacks) and stack.trigger_time_ms is not None for stack in stacks)


def _times(stacks: Sequence[PhaseStack]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Trigger times that every slice position has an image near, and echo times, ascending, ms."""
    triggers = sorted({one.trigger_time_ms for one in stacks if one.trigger_time_ms is not None and not one.lacks})
    echoes = sorted({stack.echo_time_ms for stack in stacks if stack.echo_time_ms is not None})
    return tuple(triggers), tuple(echoes)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _stack_digest(group: StackGroup) -> str:
    """Tells a group from the others of its series; the UID in it keeps the header's texts from being guessed."""
    return _digest(f"{group.series_uid}\n{group.apart}")


def _codes(groups: Sequence[StackGroup]) -> list[str]:
    """The code of each: that of its series, and after a hyphen its own where the series has several."""
    series = {_digest(group.series_uid) for group in groups}
    codes = []
    for group in groups:
        code = _code(_digest(group.series_uid), series)
        if group.apart:
            every = {_stack_digest(other) for other in groups if other.series_uid == group.series_uid}
            code += f"-{_start(_stack_digest(group), every, SHORTEST_STACK_CODE)}"
        codes.append(code)
    return codes


def _code(digest: str, every: set[str]) -> str:
    length = SHORTEST_CODE
    while digest[:length].isdecimal():
        length += 1
    return _start(digest, every, length)


def _start(digest: str, every: set[str], length: int) -> str:
    while sum(other.startswith(digest[:length]) for other in every) > 1:
        length += 1
    return digest[:length]


def choose(
    groups: Sequence[StackGroup], *, series: str | None, trigger_time_ms: float | None, echo_time_ms: float | None
) -> Choice:
    """Choose one stack.

    Parameters
    ----------
    groups
        All that the folder holds.
    series
        As in :func:`named`; None takes the one that is left without localisers, and a note tells of small stacks that
        are not called localisers and were passed over.
    trigger_time_ms, echo_time_ms
        The nearest cardiac phase and echo is taken, the earlier of two that are as near (a note says so). It may be
        off by half the median step between the times that are stated; where one is, by 5% of it, or by 5 ms (trigger
        time) or 0.05 ms (echo time) where that is more. Phases may be series of their own, if they are alike in all
        else.

    Returns
    -------
    Choice
        The group and the stack of it.

    Raises
    ------
    ScanError
        The choice is not clear, or no time is near the given one: it lists what there is.
    """
    candidates = _candidates(groups) if series is None else named(groups, series)
    if len(candidates) > 1 and (trigger_time_ms is not None or echo_time_ms is not None) and _are_phases(candidates):
        pool = [(group, group.stacks[0]) for group in candidates]
    elif len(candidates) > 1:
        what = "the folder holds several series" if series is None else "the given --series holds several stacks"
        option = _time_option(candidates)
        key = {"--trigger-time": "trigger_time_ms", "--echo-time": "echo_time_ms"}.get(option)
        how = f"--series NUMBER or {option} MS, or series or {key} in" if key else "--series NUMBER, or series in"
        raise ScanError(_with_list(f"{what}: choose one with {how} the recipe's [scan]", groups))
    else:
        pool = [(candidates[0], stack) for stack in candidates[0].stacks]
    modality = pool[0][0].modality
    if modality in OTHER_MODALITIES:
        raise ScanError(f"the images are {modality}: a CT or MR series is needed")
    notes = _passed_over(groups, candidates) if series is None else []
    if echo_time_ms is not None:
        nearest = nearest_time([stack.echo_time_ms for _, stack in pool], echo_time_ms, "echo", notes)
        pool = [one for one in pool if one[1].echo_time_ms == nearest]
    if trigger_time_ms is not None:
        nearest = nearest_time([stack.trigger_time_ms for _, stack in pool], trigger_time_ms, "trigger", notes)
        pool = [one for one in pool if one[1].trigger_time_ms == nearest]
    if len(pool) > 1:
        raise ScanError(_which_time([stack for _, stack in pool]))
    return Choice(*pool[0], tuple(notes))


def _candidates(groups: Sequence[StackGroup]) -> list[StackGroup]:
    """Groups without localisers and other kinds of image."""
    scans = [group for group in groups if group.modality not in OTHER_MODALITIES]
    stacks = [group for group in scans if len(group.stacks[0].slices) > 1] or scans or list(groups)
    stacks = [group for group in stacks if not group.is_localizer] or stacks
    largest = max(len(group.stacks[0].slices) for group in stacks)
    small = min(SMALL_STACK, SMALL_PART * largest)
    return [group for group in stacks if group.image_count > small]


def _passed_over(groups: Sequence[StackGroup], taken: Sequence[StackGroup]) -> list[str]:
    """A note on the other series whose stacks are as small as a localiser's but are not called so."""
    known = {group.series_uid for group in taken}
    scans = [group for group in groups if not group.is_localizer and group.modality not in OTHER_MODALITIES]
    count = len({group.series_uid for group in scans} - known)
    if not count:
        return []
    what = f"{count} other series {'were' if count > 1 else 'was'} passed over as small as a localiser"
    return [note(f"{what}: if one is wanted, choose it with --series, or series in the recipe's [scan]")]


def named(groups: Sequence[StackGroup], series: str) -> list[StackGroup]:
    """The groups that a text stands for.

    Parameters
    ----------
    groups
        All that the folder holds.
    series
        Number in :func:`listed`, which digits alone always are; or the code there; or a whole UID, or six or more
        digits of its code before the hyphen, which stand for the stacks of the series without its localisers.

    Raises
    ------
    ScanError
        There is none, or the code fits several series: it lists what there is.
    """
    wanted = series.strip()
    matching: list[StackGroup] = []
    if wanted.isdecimal() and wanted.isascii():
        if len(wanted) < 10 and 1 <= int(wanted) <= len(groups):
            return [groups[int(wanted) - 1]]
    elif wanted:
        code, _, own = wanted.lower().partition("-")
        is_code = len(code) >= SHORTEST_CODE and (len(own) >= SHORTEST_STACK_CODE or "-" not in wanted)
        matching = [
            group
            for group in groups
            if group.series_uid == wanted or (is_code and _digest(group.series_uid).startswith(code))
        ]
        if own:
            matching = [group for group in matching if group.apart and _stack_digest(group).startswith(own)]
            if len(matching) == 1:
                return matching
    if len({group.series_uid for group in matching}) == 1 and "-" not in wanted:
        return _candidates(matching)
    fits = "several series have this code" if matching else "no series has this number, code or UID"
    raise ScanError(
        _with_list(f"{fits} (--series, or series in the recipe's [scan]): choose a number from the list", groups)
    )


def _are_phases(groups: Sequence[StackGroup]) -> bool:
    """Whether these are alike in all but time: cardiac phases that the scanner made series of."""
    if any(len(group.stacks) > 1 or group.modality != groups[0].modality for group in groups):
        return False
    try:
        geometries = [stack_geometry(find_stack(group.stacks[0].slices)) for group in groups]
    except ScanError:
        return False
    stated = {
        tuple(image.traits.get(trait) for trait in ALIKE_IN_PHASES)
        for group in groups
        for image in group.stacks[0].slices
    }
    if len(stated) > 1:
        return False
    times = {(group.stacks[0].echo_time_ms, group.stacks[0].trigger_time_ms) for group in groups}
    return len(times) == len(groups) and all(
        one.size == geometries[0].size
        and np.allclose(one.affine, geometries[0].affine, rtol=0.0, atol=GEOMETRY_TOLERANCE_MM)
        for one in geometries
    )


def _which_time(stacks: Sequence[PhaseStack]) -> str:
    triggers, echoes = _times(stacks)
    parts = []
    if len(echoes) > 1:
        parts.append(
            f"{len(echoes)} echoes (echo times {listed_times(echoes)} ms): choose one with --echo-time MS, or "
            "echo_time_ms in the recipe's [scan]"
        )
    partial = _partial_count(stacks)
    if len(triggers) > 1 or partial:
        at_some = f", and {partial} that some slice positions have no image of" if partial else ""
        times = f" (trigger times {listed_times(triggers)} ms)" if triggers else ""
        parts.append(
            f"{len(triggers)} cardiac phase{'s' * (len(triggers) != 1)}{times}{at_some}: choose one with "
            "--trigger-time MS, or trigger_time_ms in the recipe's [scan]"
        )
    if not parts:
        parts = ["several stacks, of which some state no time: export the one that is wanted as a series of its own"]
    return f"the series holds {'; and '.join(parts)}"


def lack_problem(choice: Choice) -> str:
    """Which slice positions have no image near the time of a stack, and which times all of them have."""
    stack = choice.stack
    named_ones = [
        f"slice {lack.number}" + ("" if lack.nearest_ms is None else f" (the nearest is at {lack.nearest_ms:g} ms)")
        for lack in stack.lacks[:LACKS_NAMED]
    ]
    more = f" and {len(stack.lacks) - LACKS_NAMED} more" if len(stack.lacks) > LACKS_NAMED else ""
    time = "this time" if stack.trigger_time_ms is None else f"{stack.trigger_time_ms:g} ms"
    triggers, _ = _times(choice.group.stacks)
    whole = f"all have one near {listed_times(triggers)} ms" if triggers else "no time has all of them"
    interpolated = (
        "" if stack.lacks_an_end else ", or have them filled from their neighbours with --interpolate-missing"
    )
    return (
        f"{len(stack.lacks)} of {len(stack.slices) + len(stack.lacks)} slice positions have no image near {time}: "
        f"{', '.join(named_ones)}{more}; {whole}: choose another with --trigger-time MS, or trigger_time_ms in the "
        f"recipe's [scan]{interpolated}"
    )


def _with_list(problem: str, groups: Sequence[StackGroup]) -> list[Problem]:
    lines = [
        Problem(f"series {info.number}", f"{info.slice_count} images, {info.description} (code {info.uid_code})")
        for info in listed(groups)
    ]
    return [Problem("", problem), *lines]
