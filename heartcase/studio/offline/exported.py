"""Cases as pages for a browser, with the recordings that they play."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from heartcase.schemas.errors import Problem, UsageError
from heartcase.schemas.recording.reader import Recording, open_recording
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.live.cuts_done import ActMarks, CutsDone
from heartcase.simulator.live.live_frame import LiveFrame, moment_of
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.replay import (
    FRAMES_MAX,
    check_frame_count,
    frame_steps,
    load_session,
    refuse_deviation,
)
from heartcase.simulator.session.stored import lattice_sha256

if TYPE_CHECKING:
    from heartcase.studio.offline.site import SiteResult
    from heartcase.studio.offline.web_page import Recorded

__all__ = ["PageResult", "fitting_page_of", "page_of", "site_of"]

_TOUR_S = 10.0
"""Simulated time of a tour, about, s: how much of all that is played it counts for."""


@dataclass(frozen=True)
class PageResult:
    """A page as it was made."""

    content: bytes
    """The file."""
    tours: tuple[str, ...]
    """Titles of the guided tours in it."""
    warnings: tuple[Problem, ...]
    """Which recordings are not whole; what is wrong with tours, of each that is so."""


def page_of(
    case: Path,
    recordings: Sequence[Path],
    *,
    level: int,
    frames_per_second: float,
    tours: bool = True,
    is_partial: bool = False,
    told: Callable[[float], None] = lambda _: None,
) -> PageResult:
    """The page of a case with its recordings and its guided tours.

    With ``is_partial`` a recording that is not whole is played as far as it is whole.
    A tour that cannot be read is left out, and one that could not be done to its end ends before. ``told`` hears which
    part of all that is to be played is done, 0 to 1.

    Raises
    ------
    HeartcaseError
        The case has no surface, or a recording is not whole, of another case, too long, or does not come to what was
        recorded.
    """
    from heartcase.schemas.bundle.reader import open_bundle
    from heartcase.studio.offline.shown import shown_of
    from heartcase.studio.offline.toured import tours_of
    from heartcase.studio.offline.web_page import web_page
    from heartcase.studio.operating.scene.normal_map import load_normal_map

    opened = _opened(recordings, frames_per_second, is_partial=is_partial)
    loaded = load_case(case, needs=("surface", "structures", "cell_labels", "tissue"), level=level)
    toured, problems = tours_of(loaded, case) if tours else ([], ())
    acted = [one for one in toured if one.has_acts]
    of_each = _parts_told([*(one.seconds for _, one in opened), *(_TOUR_S for _ in acted)], told)
    played = [
        _recorded(name, one, loaded, frames_per_second, heard)
        for (name, one), heard in zip(opened, of_each, strict=False)
    ]
    for one, heard in zip(acted, of_each[len(opened) :], strict=True):
        one.told = heard
    shown = shown_of(open_bundle(case), level)
    assert loaded.surface is not None
    normal_map = load_normal_map(case, loaded.surface, level)
    made = web_page(loaded, shown, played, tours=toured, normal_map=normal_map, frames_per_second=frames_per_second)
    problems = (*_short(opened), *problems, *(each for one in toured for each in one.problems))
    return PageResult(made, tuple(one.tour.tour.title for one in toured), problems)


def fitting_page_of(
    case: Path, recordings: Sequence[Path], told: Callable[[float], None] = lambda _: None
) -> tuple[bytes, list[Problem]]:
    """The file of such a page at the full surface, and its warnings.

    It has as many pictures a second as the longest recording has room for. A recording that is not whole is played
    as far as it is, and a warning says so.

    Raises
    ------
    HeartcaseError
        As of :func:`page_of`.
    """
    from heartcase.studio.offline.web_page import FRAMES_PER_SECOND

    longest = max([1.0, *(open_recording(one, partial=True).seconds for one in recordings)])
    rate = min(FRAMES_PER_SECOND, (FRAMES_MAX - 2) / longest)
    made = page_of(case, recordings, level=0, frames_per_second=rate, is_partial=True, told=told)
    return made.content, list(made.warnings)


def site_of(
    cases: Sequence[Path],
    recordings: Sequence[Path],
    out: Path,
    *,
    level: int | None,
    frames_per_second: float,
    tours: bool = True,
    is_partial: bool = False,
    say: Callable[[str], None],
) -> SiteResult:
    """The site of some cases; each recording is played on the page of the case that it is of.

    Guided tours show there what they show; what their steps do is not done. ``is_partial`` is as of :func:`page_of`.

    Raises
    ------
    HeartcaseError
        As of :func:`page_of` and of :func:`heartcase.studio.offline.site.write_site`; or a recording is of none of the
        cases.
    """
    from heartcase.studio.offline.site import SiteCase, write_site

    opened = _opened(recordings, frames_per_second, is_partial=is_partial)
    if opened:
        lattices = {lattice_sha256(load_case(case, needs=("grid",)).model) for case in cases}
        lost = [name for name, one in opened if one.header.lattice_sha256 not in lattices]
        if lost:
            words = "is of none of these cases: add its case, or leave it out"
            raise UsageError([Problem("--recording", f"{name} {words}") for name in lost])

    def of(case: Case) -> list[Recorded]:
        own = lattice_sha256(case.model) if opened else ""
        mine = [(name, one) for name, one in opened if one.header.lattice_sha256 == own]
        return [_recorded(name, one, case, frames_per_second) for name, one in mine]

    chosen = [SiteCase(case, of, has_tours=tours) for case in cases]
    made = write_site(chosen, out, level=level, frames_per_second=frames_per_second, say=say)
    return replace(made, warnings=(*map(str, _short(opened)), *made.warnings))


def _opened(recordings: Sequence[Path], frames_per_second: float, *, is_partial: bool) -> list[tuple[str, Recording]]:
    found = [(recording.stem, open_recording(recording, partial=is_partial)) for recording in recordings]
    for _, one in found:
        check_frame_count(one, frames_per_second)
    return found


def _short(opened: Sequence[tuple[str, Recording]]) -> list[Problem]:
    return [words for _, one in opened if (words := one.partial_warning) is not None]


def _parts_told(seconds: Sequence[float], told: Callable[[float], None]) -> list[Callable[[float], None]]:
    """For each of some things that last so long, who hears which part of it is done; ``told`` hears it of all."""
    done = [0.0] * len(seconds)
    whole = max(sum(seconds), 1e-9)

    def heard(part: float, number: int) -> None:
        done[number] = part * seconds[number]
        told(sum(done) / whole)

    return [partial(heard, number=number) for number in range(len(seconds))]


def _recorded(
    name: str,
    recording: Recording,
    case: Case,
    frames_per_second: float,
    told: Callable[[float], None] = lambda _: None,
) -> Recorded:
    from heartcase.studio.offline.web_page import Recorded

    tissue = case.tissue if recording.header.tissue_sha256 else TissueSamples.everywhere()
    session = load_session(recording, case.model, surface=case.surface, tissue=tissue)
    return Recorded(name, _moments(session, frames_per_second, told))


def _moments(session: OperatingSession, frames_per_second: float, told: Callable[[float], None]) -> Iterator[LiveFrame]:
    """Moments of a recording, the first one included; at the end it is checked against what was recorded."""
    first, last = session.start_step, session.end_step
    cuts, marks = CutsDone(), ActMarks()

    def moment() -> LiveFrame:
        frame = session.frame(surface=True)
        cuts.note(session, frame)
        marks.note(session)
        return replace(moment_of(session, frame), act_count=cuts.act_count, cuts=cuts.cuts, marks=marks.marks)

    yield moment()
    for step in frame_steps(session, frames_per_second):
        for _ in session.play(step):
            pass
        told((step - first) / max(last - first, 1))
        yield moment()
    for _ in session.play():
        pass
    refuse_deviation(session)
