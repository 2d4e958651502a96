"""Which images of a series belong to one stack, where the series holds several.

Images of another size, spacing, orientation, study or coordinate system are another stack (a localiser among them).
Images that share a slice position are told apart by what their headers state: kind of image, echo, energy, b-value,
cardiac phase, time, acquisition. A stack is made of what states the same at every position. Stacks whose positions
differ, such as one in the gaps of another, are told apart by the same. Nothing is told apart by file names or instance
numbers, which say nothing about the patient.
"""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from heartcase.pipeline.formats.dicom.headers import ImageSeries
from heartcase.pipeline.formats.dicom.stack import COSINE_TOLERANCE, SPACING_TOLERANCE, Slice, places_of, stack_problem

__all__ = ["TIME_TOLERANCE_MS", "Lack", "PhaseStack", "StackGroup", "stack_groups"]

SPLIT_BY = (
    "image_kind",
    "stack_id",
    "echo_time_ms",
    "tube_voltage_kv",
    "b_value",
    "inversion_time_ms",
    "temporal_position",
    "cardiac_phase_percent",
    "trigger_time_ms",
    "acquisition_number",
    "sequence",
)
"""Traits in the order in which they are tried."""
SPLIT_BETWEEN = ("stack_id", "tube_voltage_kv", "inversion_time_ms", "temporal_position", "sequence")
"""Traits that tell apart stacks of which one lies in the gaps of the other."""
SPLIT_IN_TIME = ("cardiac_phase_percent", "trigger_time_ms")
"""Traits that tell apart stacks at other positions, wherever these lie."""
TIME_TOLERANCE_MS = 50.0
"""Largest difference between the trigger times of a stack that goes without a word: heartbeats differ, and a heart
moves little in this time."""
PERCENT_TOLERANCE = 5.0
"""As above, as a part of the heartbeat."""
CHOSEN_BY_TIME = ("echo_time_ms", "temporal_position", "cardiac_phase_percent", "trigger_time_ms")
"""Traits that one group of stacks may differ in: a time chooses among them."""
KIND_WORDS = {
    "LOCALIZER": "localiser",
    "DERIVED": "derived",
    "M": "magnitude",
    "M_FFE": "magnitude",
    "MAGNITUDE": "magnitude",
    "P": "phase",
    "PHASE": "phase",
    "PHASE MAP": "phase",
    "VELOCITY": "phase",
    "R": "real",
    "REAL": "real",
    "I": "imaginary",
    "IMAGINARY": "imaginary",
    "WATER": "water",
    "FAT": "fat",
    "IN_PHASE": "in phase",
    "OUT_PHASE": "out of phase",
    "OPP_PHASE": "out of phase",
    "ADC": "diffusion coefficient",
    "MIP": "projection",
    "MAX_IP": "projection",
    "MPR": "reformatted",
}
"""Defined terms of an image's type that may be shown, and how."""
TRAIT_WORDS = {
    "echo_time_ms": "echo time {:g} ms",
    "tube_voltage_kv": "{:g} kV",
    "b_value": "b-value {:g} s/mm2",
    "inversion_time_ms": "inversion time {:g} ms",
    "temporal_position": "time {:g}",
    "cardiac_phase_percent": "{:g}% of the heartbeat",
    "trigger_time_ms": "trigger time {:g} ms",
    "acquisition_number": "acquisition {:g}",
}

Branch = tuple[tuple[str, Hashable], ...]
Spare = defaultdict[Branch, list[Slice]]


SPARE = "spare"
"""Class of an image that is near no time of a stack, or less near than another at its position."""


class Lack(NamedTuple):
    """A slice position that has no image near the time of a stack."""

    number: int
    """Which position it is, from 1, of all that the phases have."""
    nearest_ms: float | None
    """Time of the nearest image there; None where none is stated."""


@dataclass(frozen=True)
class PhaseStack:
    """Images that should form one stack, with what they state about time."""

    slices: tuple[Slice, ...]
    """The images in any order."""
    trigger_time_ms: float | None
    """Median time after the R wave, ms."""
    trigger_spread_ms: float
    """Largest difference of it between the slices, ms."""
    cardiac_phase_percent: float | None
    """Part of the heartbeat, where all slices agree."""
    echo_time_ms: float | None
    """Echo time, where all slices agree."""
    lacks: tuple[Lack, ...] = ()
    """Slice positions that other times of the same stack have and this one has not, in order."""

    @property
    def lacks_an_end(self) -> bool:
        """Whether the first or the last position is among them: nothing else would tell."""
        count = len(self.slices) + len(self.lacks)
        return any(lack.number in (1, count) for lack in self.lacks)


@dataclass(frozen=True)
class StackGroup:
    """What one number of the list stands for: the stacks of a series that differ in cardiac phase and echo alone."""

    series_uid: str
    """Not to be shown."""
    modality: str
    """As in :class:`~heartcase.pipeline.formats.dicom.headers.ImageSeries`."""
    stacks: tuple[PhaseStack, ...]
    """By echo time, then time."""
    kind: str
    """What tells it from other groups, in words; may be empty."""
    is_localizer: bool
    """Whether the headers call it a localiser."""
    apart: str = ""
    """What tells it from the other groups of its series: not to be shown; empty where there is one group."""
    left_out: str = ""
    """Which smaller groups of the series are left out when this one is chosen, in words; empty where there is none."""
    scanner_number: int | None = None
    """Number of its series on the scanner, where it is known."""

    @property
    def image_count(self) -> int:
        """Number of images of all stacks."""
        return sum(len(stack.slices) for stack in self.stacks)


def stack_groups(series: ImageSeries) -> tuple[StackGroup, ...]:
    """Sort the images of a series into stacks.

    Parameters
    ----------
    series
        The series.

    Returns
    -------
    tuple of StackGroup
        One or more: the largest first, whatever the order of the images. A group is not always an even stack: what
        is wrong with it is said when it is chosen.
    """
    groups: list[tuple[tuple[PhaseStack, ...], list[str], str, int]] = []
    systems = sorted({image.coordinates for image in series.slices})
    for alike in _alike(series.slices):
        where = f"coordinate system {systems.index(alike[0].coordinates) + 1} of {len(systems)}"
        system = [where] if len(systems) > 1 else []
        spare: Spare = defaultdict(list)
        leaves = _split(alike, SPLIT_BY, (), spare) if _is_placed(alike[0]) else [((), alike)]
        branches: dict[Branch, list[tuple[Branch, tuple[Slice, ...]]]] = defaultdict(list)
        for branch, slices in leaves:
            branches[_without_times(branch)].append((branch, slices))
        for key, members in branches.items():
            found = [(branch, _phase_stack(slices)) for branch, slices in members]
            if len(members) > 1 or spare[key]:
                found = _with_lacks(found, spare[key])
            times = [(stack.echo_time_ms, stack.trigger_time_ms) for _, stack in found]
            if len(set(times)) == len(times):
                ordered = sorted((stack for _, stack in found), key=_time_order)
                words = _words(members[0][0], ordered[0].slices, is_one=len(ordered) == 1)
                groups.append((tuple(ordered), words + system, _apart(alike[0], key), len(spare[key])))
            else:
                for branch, stack in found:
                    words = _words(branch, stack.slices, is_one=True)
                    groups.append(((stack,), words + system, _apart(alike[0], branch), 0))
    groups.sort(key=lambda group: -_count(group[0]))
    repeated = Counter(", ".join(words) for _, words, *_ in groups)
    seen: Counter[str] = Counter()
    made = []
    for stacks, words, apart, spare_count in groups:
        kind = ", ".join(words)
        seen[kind] += 1
        numbered = f"{kind}, {seen[kind]} of {repeated[kind]}" if kind and repeated[kind] > 1 else kind
        is_localizer = all(image.is_localizer for stack in stacks for image in stack.slices)
        others = [other for other, *_ in groups if _count(other) < _count(stacks)]
        left_out = _left_out(stacks[0].slices[0], others)
        if spare_count:
            of_time = (
                f"{spare_count} image{'s are' if spare_count > 1 else ' is'} left out: at a time that other slice "
            )
            left_out = "; ".join(part for part in (left_out, f"{of_time}positions have no image near to") if part)
        apart = apart if len(groups) > 1 else ""
        number = series.scanner_number
        made.append(StackGroup(series.uid, series.modality, stacks, numbered, is_localizer, apart, left_out, number))
    return tuple(made)


def _apart(first: Slice, branch: Branch) -> str:
    return repr((first.shape, _is_placed(first), first.spacing, first.orientation, first.coordinates, branch))


def _without_times(branch: Branch) -> Branch:
    return tuple(step for step in branch if step[0] not in CHOSEN_BY_TIME)


def _with_lacks(found: list[tuple[Branch, PhaseStack]], spare: Sequence[Slice]) -> list[tuple[Branch, PhaseStack]]:
    """The stacks of one group, each with the slice positions that the others of its echo have and it has not.

    Stacks without a position in common lie beside each other, and lack nothing.
    """
    every = [image for _, stack in found for image in stack.slices] + list(spare)
    places = places_of(every).tolist()
    ends = np.cumsum([len(stack.slices) for _, stack in found]).tolist()
    own = [set(places[end - len(stack.slices) : end]) for end, (_, stack) in zip(ends, found, strict=True)]
    made = []
    for mine, (branch, stack) in zip(own, found, strict=True):
        alike = [other for other, (_, one) in zip(own, found, strict=True) if one.echo_time_ms == stack.echo_time_ms]
        whole = mine.union(places[ends[-1] :], *(other for other in alike if other & mine))
        lacks = []
        for number, place in enumerate(sorted(whole), start=1):
            if place not in mine:
                times = [
                    image.traits.get("trigger_time_ms") for image, at in zip(every, places, strict=True) if at == place
                ]
                stated = [time for time in times if isinstance(time, float)]
                wanted = stack.trigger_time_ms or 0.0
                lacks.append(Lack(number, min(stated, key=lambda time: (abs(time - wanted), time), default=None)))
        made.append((branch, dataclasses.replace(stack, lacks=tuple(lacks))))
    return made


def _count(stacks: Sequence[PhaseStack]) -> int:
    return sum(len(stack.slices) for stack in stacks)


def _left_out(first: Slice, others: Sequence[Sequence[PhaseStack]]) -> str:
    images = [image for stacks in others for stack in stacks for image in stack.slices if not image.is_localizer]
    if not images:
        return ""
    why: dict[str, None] = {}
    for image in images:
        if not image.is_grey:
            why["in colour"] = None
        elif not _is_placed(image):
            why["no place in the patient stated"] = None
        elif not _is_placed(first) or _is_alike(first, image):
            why["another kind, time or acquisition"] = None
        elif image.shape != first.shape:
            why["another size"] = None
        elif not _is_parallel(first, image):
            why["another orientation"] = None
        elif image.coordinates != first.coordinates:
            why["another study or coordinate system"] = None
        else:
            why["another pixel spacing"] = None
    are = "images of the series are" if len(images) > 1 else "image of the series is"
    return f"{len(images)} {are} left out: {', '.join(why)}"


def _is_placed(image: Slice) -> bool:
    return image.is_grey and None not in (image.position, image.orientation, image.spacing)


def _alike(slices: Sequence[Slice]) -> list[tuple[Slice, ...]]:
    """Images of one size, spacing, orientation and coordinate system, within the tolerance of a stack."""
    found: list[tuple[Slice, list[Slice]]] = []
    known: dict[Hashable, list[Slice]] = {}
    for image in sorted(slices, key=_header_order):
        exact = (image.shape, _is_placed(image), image.is_grey, image.orientation, image.spacing, image.coordinates)
        if exact not in known:
            members = next((members for first, members in found if _is_alike(first, image)), None)
            if members is None:
                members = []
                found.append((image, members))
            known[exact] = members
        known[exact].append(image)
    return [tuple(members) for _, members in found]


def _header_order(image: Slice) -> tuple[Hashable, ...]:
    """Sorts by what the header says, since the first of a stack stands for it."""
    return image.shape, image.orientation or (), image.spacing or (), image.coordinates, image.position or (), image.uid


def _is_alike(first: Slice, image: Slice) -> bool:
    if (first.shape, _is_placed(first), first.is_grey) != (image.shape, _is_placed(image), image.is_grey):
        return False
    if first.coordinates != image.coordinates:
        return False
    if not _is_placed(first):
        return True
    spacing = np.array(first.spacing)
    spacings = np.abs(spacing - np.array(image.spacing)) / np.maximum(np.abs(spacing), 1e-9)
    return _is_parallel(first, image) and bool(spacings.max() <= SPACING_TOLERANCE)


def _is_parallel(first: Slice, image: Slice) -> bool:
    return bool(np.abs(np.array(first.orientation) - np.array(image.orientation)).max() <= COSINE_TOLERANCE)


def _split(
    slices: tuple[Slice, ...], traits: tuple[str, ...], branch: Branch, spare: Spare
) -> list[tuple[Branch, tuple[Slice, ...]]]:
    """Split by the traits that differ at one position, until no position repeats or no trait is left.

    ``spare`` gets the images that belong to no time that is left, by the branch without times.
    """
    places = places_of(slices)
    if places.max() == 0:  # one slice: no choice of a time makes a stack of it
        return [(branch, slices)]
    if len(set(places.tolist())) == len(slices):
        return _split_apart(slices, branch)
    for number, trait in enumerate(traits):
        values = [image.traits.get(trait) for image in slices]
        at_place: dict[int, set[float | str | None]] = defaultdict(set)
        for place, value in zip(places.tolist(), values, strict=True):
            at_place[place].add(value)
        if max(len(there) for there in at_place.values()) < 2:
            continue
        classes = _ranks(at_place, places.tolist(), values) if trait == "trigger_time_ms" else values
        parts: dict[Hashable, list[Slice]] = defaultdict(list)
        for image, one in zip(slices, classes, strict=True):
            parts[one].append(image)
        left = parts.pop(SPARE, []) if trait == "trigger_time_ms" else []
        if trait != "image_kind" and not _is_orderly(at_place, len(parts), is_time=trait == "trigger_time_ms"):
            continue
        spare[_without_times(branch)] += left
        found: list[tuple[Branch, tuple[Slice, ...]]] = []
        for one in sorted(parts, key=_sortable):
            found += _split(tuple(parts[one]), traits[number + 1 :], (*branch, (trait, one)), spare)
        return found
    return [(branch, slices)]


def _is_orderly(at_place: dict[int, set[float | str | None]], class_count: int, *, is_time: bool) -> bool:
    """Whether a trait differs at most positions, and more so there than from position to position.

    An acquisition number that counts breath-holds does not; nor does one image that was taken again. More than two
    times of the heartbeat at one position are phases even where other positions have one.
    """
    counts = [len(there) for there in at_place.values()]
    at_most = 2 * sum(count > 1 for count in counts) >= len(counts) or (is_time and max(counts) > 2)
    return at_most and class_count <= 2 * max(counts)


def _split_apart(slices: tuple[Slice, ...], branch: Branch) -> list[tuple[Branch, tuple[Slice, ...]]]:
    """Stacks whose positions differ: split by a trait of which every value has an even stack of its own.

    Where all positions together are even too, only such traits split as never differ within a stack.
    """
    is_even = stack_problem(slices) is None
    for trait in SPLIT_BY:
        if trait in dict(branch) or (is_even and trait not in (*SPLIT_BETWEEN, *SPLIT_IN_TIME)):
            continue
        values = [image.traits.get(trait) for image in slices]
        classes = _distant(values, trait) if is_even and trait in SPLIT_IN_TIME else values
        parts: dict[Hashable, list[Slice]] = defaultdict(list)
        for image, one in zip(slices, classes, strict=True):
            parts[one].append(image)
        if not 1 < len(parts) <= len(slices) // 2 or any(stack_problem(part) for part in parts.values()):
            continue
        if not is_even or trait in SPLIT_IN_TIME or _is_between(slices, classes):
            found: list[tuple[Branch, tuple[Slice, ...]]] = []
            for one in sorted(parts, key=_sortable):
                found += _split_apart(tuple(parts[one]), (*branch, (trait, one)))
            return found
    return [(branch, slices)]


def _distant(values: Sequence[float | str | None], trait: str) -> list[Hashable]:
    """Number of the class of each time: the times of neighbouring classes differ by more than the tolerance."""
    tolerance = TIME_TOLERANCE_MS if trait == "trigger_time_ms" else PERCENT_TOLERANCE
    stated = np.unique([value for value in values if isinstance(value, float)])
    starts = stated[1:][np.diff(stated) > tolerance]
    return [int(np.searchsorted(starts, value, side="right")) if isinstance(value, float) else None for value in values]


def _is_between(slices: tuple[Slice, ...], classes: Sequence[Hashable]) -> bool:
    """Whether a class has positions on both sides of one of another, unlike slabs that follow each other."""
    along = [classes[index] for index in np.argsort(places_of(slices), kind="stable")]
    changes = sum(one != other for one, other in pairwise(along))
    return bool(changes >= len(set(along)))


def _ranks(
    at_place: dict[int, set[float | str | None]], places: list[int], values: list[float | str | None]
) -> list[Hashable]:
    """Number of the cardiac phase of each image: heartbeats differ, so the times of a phase differ between slices.

    Where every position has as many times, the n-th time is phase n. Else the phases are those of the positions that
    have the usual number of times; at each other position a phase takes the image that is nearest in time to its
    median time, if it is near. What is left over is spare.
    """
    times = {place: sorted(v for v in there if isinstance(v, float)) for place, there in at_place.items()}
    counts = Counter(len(one) for one in times.values() if one)
    usual = max(counts, key=lambda count: (counts[count], count), default=0)
    reference = np.median([one for one in times.values() if len(one) == usual], axis=0) if usual else np.zeros(0)
    reach = max(TIME_TOLERANCE_MS, float(np.median(np.diff(reference))) / 2.0 if usual > 1 else 0.0)
    taken = {place: dict(enumerate(one)) for place, one in times.items() if len(one) == usual}
    for place, one in times.items():
        for time in one if len(one) != usual else ():
            phase = int(np.abs(reference - time).argmin())
            known = taken.setdefault(place, {})
            off = abs(time - reference[phase])
            if off <= reach and (phase not in known or off < abs(known[phase] - reference[phase])):
                known[phase] = time
    ranks: list[Hashable] = []
    for place, value in zip(places, values, strict=True):
        if isinstance(value, float):
            ranks.append(next((phase for phase, time in taken.get(place, {}).items() if time == value), SPARE))
        else:
            ranks.append(None)
    return ranks


def _sortable(value: Hashable) -> tuple[bool, float, str]:
    is_number = isinstance(value, float | int)
    return value is None, float(value) if is_number else 0.0, "" if is_number else str(value)  # type: ignore[arg-type]


def _phase_stack(slices: tuple[Slice, ...]) -> PhaseStack:
    def agreed(trait: str) -> float | None:
        found = {image.traits.get(trait) for image in slices}
        value = found.pop() if len(found) == 1 else None
        return value if isinstance(value, float) else None

    times = [time for image in slices if isinstance(time := image.traits.get("trigger_time_ms"), float)]
    is_stated = len(times) == len(slices)
    return PhaseStack(
        slices=slices,
        trigger_time_ms=float(np.median(times)) if is_stated else None,
        trigger_spread_ms=max(times) - min(times) if is_stated else 0.0,
        cardiac_phase_percent=agreed("cardiac_phase_percent"),
        echo_time_ms=agreed("echo_time_ms"),
    )


def _time_order(stack: PhaseStack) -> tuple[float, float]:
    return stack.echo_time_ms or 0.0, stack.trigger_time_ms or 0.0


def _words(branch: Branch, slices: tuple[Slice, ...], *, is_one: bool) -> list[str]:
    """What sets a group apart, in words that name no text of a header but defined terms."""
    words: list[str] = []
    kind = str(slices[0].traits.get("image_kind", "")).split("/")
    if len({image.traits.get("image_kind") for image in slices}) == 1:
        words += dict.fromkeys(KIND_WORDS[term] for term in kind if term in KIND_WORDS)
    for trait, value in branch:
        if trait in TRAIT_WORDS and isinstance(value, float) and (is_one or trait not in CHOSEN_BY_TIME):
            words.append(TRAIT_WORDS[trait].format(value))
    return words
