"""The case on which pages operate: loaded once, with one live session at a time, and its recordings."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.bundle.manifest import manifest_bytes
from heartcase.schemas.errors import HeartcaseError, Problem, RecordingError, UsageError
from heartcase.schemas.recording.header import read_header
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.background.device_hand import DeviceHand
from heartcase.simulator.case_simulation import simulation_of_case
from heartcase.simulator.haptics.servo import HapticServo
from heartcase.simulator.incisions.stated_defects import landmarks_with_defects
from heartcase.simulator.incisions.strain import vertex_colours
from heartcase.simulator.live.live import FRAME_S, Live
from heartcase.simulator.live.live_frame import LiveFrame
from heartcase.simulator.live.shapes import CUT_FACES, STRETCH_SHOWN, Structures
from heartcase.simulator.live.strain_worker import StrainWorker
from heartcase.simulator.live.tools import TOOLS
from heartcase.simulator.load import Case, load_case
from heartcase.simulator.session.operating_session import OperatingSession
from heartcase.simulator.session.recorder import Recorder
from heartcase.simulator.session.replay import load_session
from heartcase.studio.operating.devices import device_of, known_devices
from heartcase.studio.operating.incisions import Incisions, is_held_open
from heartcase.studio.operating.live_figures import ShownFigures
from heartcase.studio.operating.scene.cell_labels import CellLabels
from heartcase.studio.operating.scene.coarser import CoarseLevel, CoarserWorker, load_coarser
from heartcase.studio.operating.scene.heart_axes import heart_axes
from heartcase.studio.operating.scene.normal_map import NormalMap, load_normal_map
from heartcase.studio.operating.scene.packing import picture_message, stretch_bytes
from heartcase.studio.operating.scene.surroundings import cannulae

__all__ = ["Stage", "open_stage"]

_SLOWEST_FRAME_S = 1.0 / 30.0
"""How long a frame is to take where the machine does not keep up, s: then time goes slower, not the pictures."""
_RECORDINGS_MAX = 10_000
_NAME = re.compile(r"\w[\w ()+,-]{0,79}")
"""What a recording may be called: a name of its own in its folder, never a path."""
_KEEP_S = 60.0
"""Longest time that is waited for a recording to be written, s."""


class Stage:
    """A case, and the session that runs on it.

    Parameters
    ----------
    case
        The case, loaded with surface, structures, tissue and the labels of its cells.
    out
        Folder that recordings are put into, and taken from.
    heard
        Called by the session's thread when there is a new frame.
    normal_map
        The case's normal map, where it has one.
    coarser
        The surface at coarser levels of detail, where the case has them.
    sha256
        Hash of the case's manifest, which lists the hash of each file; None where it is not known.
    axes
        The heart's own planes, as :func:`heartcase.studio.operating.scene.heart_axes.heart_axes` finds them.
    """

    def __init__(
        self,
        case: Case,
        out: Path,
        heard: Callable[[], None],
        normal_map: NormalMap | None = None,
        *,
        coarser: tuple[CoarseLevel, ...] = (),
        sha256: str | None = None,
        axes: Mapping[str, Any] | None = None,
    ) -> None:
        assert case.triangle_structures is not None
        self._case = case
        self._out = out
        self._heard = heard
        self.normal_map = normal_map
        self._sha256 = sha256
        self._cannulae = cannulae(case)
        self._axes = axes or {"planes": {}, "centre_mm": None}
        self.structures = Structures(case.manifest, case.triangle_structures)
        self.cell_labels = CellLabels(case)
        self._strain: StrainWorker | None = None
        self._levels = coarser
        self._coarser: CoarserWorker | None = None
        self._spares = False
        self.incisions = Incisions(case)
        self.device: DeviceHand | None = None
        self.figures = ShownFigures(self.incisions, landmarks_with_defects(case.manifest), heard)
        self.live = self._started(self._new_session())

    @property
    def case(self) -> Case:
        """The case that was loaded."""
        return self._case

    def close(self) -> None:
        """End the session; a recording is finished."""
        self.detach()
        self.live.close()
        self.show_strain(False)
        self.show_coarser(False)
        self.figures.show(False)

    def end(self) -> str | None:
        """End the session for good, and write what was done into a recording where no recording has it yet.

        Returns
        -------
        str or None
            The recording's name; None where there was nothing to be kept.

        Raises
        ------
        RecordingError
            It cannot be kept.
        """
        self.close()
        live = self.live
        if not live.has_ended:
            raise RecordingError("the session does not end: what was done cannot be written", place="recording")
        if live.is_kept:
            return None
        for path in self._free_paths():
            try:
                with Recorder(live.session, path, case=self._case.manifest):
                    return path.name
            except RecordingError:
                # a session beside this one may have taken the name meanwhile
                if not path.exists():
                    raise
        raise RecordingError("what was done cannot be written", place="recording")

    def is_of(self, path: Path) -> bool:
        """Whether the case that lies there now is the one that was loaded; it may have been built anew."""
        return self._sha256 is not None and _manifest_sha256(path) == self._sha256

    def begin(self) -> None:
        """Leave the session, and begin anew with the case as it was built."""
        self.detach()
        self.live.close()
        self.live = self._started(self._new_session())

    def replay(self, name: str, speed: float = 1.0, *, skips: bool = False) -> float | None:
        """Leave the session, and play a recording from its start; ``speed`` and ``skips`` are those of ``Live.play``.

        One that is not whole is played as far as it is; the one that this session records is finished before.

        Returns
        -------
        float or None
            How long it is played of one that is not whole, s; None where it is.

        Raises
        ------
        HeartcaseError
            There is no such recording, or it is not of this case; the session goes on.
        """
        path = self._out / self.known(name)
        if self.live.newest.recording == name:
            self.live.stop_recording()
            self.live.settle(_KEEP_S)
        recording = open_recording(path, partial=True)
        case = self._case
        session = load_session(recording, case.model, surface=case.surface, tissue=case.tissue)
        self.detach()
        self.live.close()
        self.live = self._started(session, speed=speed, skips=skips)
        return None if recording.is_whole else recording.seconds

    def recordings(self) -> list[str]:
        """Names of the recordings that are there, the newest first."""
        return sorted(self._found(), key=lambda name: (self._out / name).stat().st_mtime, reverse=True)

    def unfinished(self) -> list[str]:
        """Names of the recordings that have no end: a server was killed, or another program is at work on them.

        The one that this session records is not among them.
        """
        return [name for name in self._found() if name != self.live.newest.recording and self._is_unfinished(name)]

    def _is_unfinished(self, name: str) -> bool:
        try:
            return read_header(self._out / name).end is None
        except HeartcaseError:
            return False

    def known(self, name: str) -> str:
        """The name of a recording that is there.

        Raises
        ------
        RecordingError
            There is none of this name.
        """
        if name not in self._found():
            raise RecordingError("there is no recording of this name: look at the list again", place="recording")
        return name

    def finished(self, name: str) -> str:
        """The name of a recording that is there, and that this session does not record.

        Raises
        ------
        RecordingError
            There is none of this name, or it is being recorded.
        """
        if self.live.newest.recording == self.known(name):
            # it is not ended unasked: what is done next shall be in it
            raise RecordingError("it is being recorded: end the recording first", place="recording")
        return name

    def rename(self, name: str, to: str) -> None:
        """Give a recording another name, without its ending.

        Raises
        ------
        RecordingError
            There is no such recording, it is being written, or the name is none for a recording, or taken.
        """
        path, new = self._out / self.finished(name), self._out / f"{to.strip()}.recording"
        if not _NAME.fullmatch(to.strip()):
            raise RecordingError(
                "a name begins with a letter, a digit or _, and has no more than 80 of these, spaces and ( ) + , -: "
                "choose another",
                place="recording",
            )
        if new.exists():
            raise RecordingError("there is already a recording of this name: choose another", place="recording")
        try:
            path.rename(new)
        except OSError as error:
            raise RecordingError(
                f"it cannot be renamed: {error.strerror or 'no reason given'}", place="recording"
            ) from None

    def record(self) -> None:
        """Record what is done, from the session's start on, under the next free name."""
        for path in self._free_paths():
            self.live.record(path)
            return

    def keep(self) -> str | None:
        """Write what was done into a recording where no recording has it yet, and wait for it.

        Nothing else may be asked meanwhile.

        Returns
        -------
        str or None
            The recording's name; None where there was nothing to be kept.

        Raises
        ------
        RecordingError
            It cannot be kept.
        """
        live = self.live
        if live.newest.frame.coming_cuts:
            live.make_cuts()
            live.settle(_KEEP_S)
        if live.is_kept:
            return None
        before = set(self._found())
        self.record()
        live.stop_recording()
        live.settle(_KEEP_S)
        made = sorted(set(self._found()) - before)
        if not live.is_kept or not made:
            raise RecordingError("what was done cannot be written", place="recording")
        return made[0]

    def spare_a_processor(self) -> None:
        """Leave a processor to a browser of this machine that draws without a graphics card."""
        if not self._spares:
            self._spares = True
            self.live.spare_a_processor()

    def cut_planned(self, name: str) -> None:
        """Cut along a planned incision.

        Raises
        ------
        UsageError
            The case has no such incision.
        """
        self.live.do(self.incisions.cut(name))

    def hold_open(self, number: int) -> None:
        """Close hands on both lips of a cut, by its place among those that are done, and lead them apart.

        Raises
        ------
        UsageError
            There is no such cut, or it has no line on the tissue.
        HeartcaseError
            No hand could close, as where it is held open already: none is led.
        """
        live = self.live
        cuts = live.newest.cuts
        if number >= len(cuts):
            raise UsageError("there is no such incision: cut first", place="incision")
        if is_held_open(live.newest, number):
            raise UsageError("this cut is held open already: let all go first", place="incision")
        hands = self.incisions.hands(cuts[number], number)
        closing = [live.asked(close) for close, _, _ in hands]
        _, late = wait(closing, _KEEP_S)
        if late:
            for one in late:
                one.cancel()
            raise UsageError("the session does not answer: begin anew", place="incision")
        refused = [problem for one in closing for problem in _refused(one)]
        if all(one.exception() is not None for one in closing):
            raise UsageError(refused)
        for problem in refused:
            live.tell(problem)
        for (_, led, speed_mm_s), closed in zip(hands, closing, strict=True):
            if closed.exception() is None:
                live.lead(led, speed_mm_s)

    def attach(self, name: str, centre_mm: Float64) -> None:
        """Let a haptic device lead a hand in the session.

        Parameters
        ----------
        name
            One of :func:`heartcase.studio.operating.devices.known_devices`.
        centre_mm
            Where the middle of its way lies, LPS mm, shape (3,).

        Raises
        ------
        HeartcaseError
            There is no such device, it cannot be opened, or there is one already.
        """
        if self.device is not None and self.device.is_attached:
            raise UsageError("a device leads a hand already: stop it first", place="device")
        self.detach()
        servo = HapticServo([device_of(name, centre_mm)]).__enter__()
        self.device = DeviceHand(self.live, servo)
        # it is led by steps
        self.live.pause(False)

    def detach(self) -> None:
        """Take the device away: what it led lets go softly."""
        device, self.device = self.device, None
        if device is not None:
            device.detach()

    def show_strain(self, is_wanted: bool) -> None:
        """Work out how far the tissue is stretched, or leave it."""
        if is_wanted and self._strain is None:
            self._strain = StrainWorker()
            self._strain.ask(self.live.newest.frame)
        elif not is_wanted and self._strain is not None:
            self._strain.close()
            self._strain = None

    def show_coarser(self, is_wanted: bool) -> None:
        """Have the coarser levels of detail follow what is cut, or leave them."""
        if is_wanted and self._coarser is None and self._levels:
            self._coarser = CoarserWorker(self._levels, self._heard)
        elif not is_wanted and self._coarser is not None:
            self._coarser.close()
            self._coarser = None

    def coarser(self, live: LiveFrame) -> tuple[CoarseLevel, ...]:
        """The coarser levels of a moment; none where they are not known yet, or there are none."""
        # another thread may leave it meanwhile
        worker = self._coarser
        if worker is None:
            return ()
        known = worker.newest
        if known is not None and known[0] is live.surface:
            return known[1]
        worker.ask(live)
        return ()

    def stretch(self, live: LiveFrame) -> Any:
        """Stretch around each node as bytes, of a moment of late; None where it is not known of this lattice."""
        worker = self._strain
        if worker is None:
            return None
        known = worker.newest
        worker.ask(live.frame)
        return None if known is None or known[0] is not live.frame.model else stretch_bytes(known[1], STRETCH_SHOWN)

    def greeting(self) -> dict[str, Any]:
        """What a page must know of the case before the first frame."""
        case, simulation = self._case, self.live.session.simulation
        assert case.surface is not None
        low, high = case.surface.rest_mm.min(axis=0), case.surface.rest_mm.max(axis=0)
        return {
            "name": case.manifest.name,
            "notice": case.manifest.notice,
            "structures": [
                {"value": one.number, "name": one.name, "colour": "#{:02x}{:02x}{:02x}".format(*one.colour)}
                for one in self.structures.all
            ],
            "tissue_inside": self.cell_labels.inside(self.structures),
            "cut_faces": CUT_FACES,
            "heart_axes": self._axes,
            "cannulae": self._cannulae,
            "tools": [
                {"key": tool.key, "size_words": tool.size_words, "size": tool.size, "sizes": tool.sizes}
                for tool in TOOLS
            ],
            "box_mm": [low.tolist(), high.tolist()],
            "step_s": simulation.step_s,
            "incisions": self.incisions.names,
            "devices": known_devices(),
            "stretch_shown": STRETCH_SHOWN,
            "stretch_colours": vertex_colours(np.linspace(*STRETCH_SHOWN, 256), *STRETCH_SHOWN).tolist(),
        }

    def picture_message(self) -> bytes | None:
        """The normal map's picture for a page; None where the case has none."""
        return None if self.normal_map is None else picture_message(self.normal_map)

    def _free_paths(self) -> Iterator[Path]:
        """Where a recording may be put, the first one first."""
        name = re.sub(r"[^A-Za-z0-9_-]+", "_", self._case.manifest.name)
        there = self._found()
        for number in range(1, _RECORDINGS_MAX):
            path = self._out / f"{name}-{number}.recording"
            if path.name not in there and not path.exists():
                yield path

    def _found(self) -> list[str]:
        try:
            return [one.name for one in self._out.iterdir() if one.suffix == ".recording" and not one.is_symlink()]
        except OSError:
            return []

    def _new_session(self) -> OperatingSession:
        return OperatingSession(simulation_of_case(self._case))

    def _started(self, session: OperatingSession, *, speed: float | None = None, skips: bool = False) -> Live:
        session.simulation.prepare()
        session.simulation.prepare_cuts()
        live = Live(
            session,
            manifest=self._case.manifest,
            slowest=_SLOWEST_FRAME_S / FRAME_S,
            shows_surface=False,
            heard=self._heard,
        )
        if self._spares:
            live.spare_a_processor()
        if speed is not None:
            live.play(speed, skips=skips)
        live.start()
        return live


def open_stage(path: Path, *, out: Path, heard: Callable[[], None]) -> Stage:
    """Load a case, and begin a session on it.

    Parameters
    ----------
    path
        The case's folder.
    out, heard
        As of :class:`Stage`.

    Raises
    ------
    HeartcaseError
        The case cannot be read.
    """
    while True:
        sha256 = _manifest_sha256(path)
        case = load_case(path, needs=("surface", "structures", "tissue", "cell_labels"))
        assert case.surface is not None
        normal_map, axes = load_normal_map(path, case.surface), heart_axes(path)
        coarser = load_coarser(path)
        # A build may have put another case there meanwhile.
        if _manifest_sha256(path) == sha256:
            return Stage(case, out, heard, normal_map, coarser=coarser, sha256=sha256, axes=axes)


def _refused(closed: Future[None]) -> tuple[Problem, ...]:
    """Why a command was refused; nothing where it was done."""
    error = closed.exception()
    if error is not None and not isinstance(error, HeartcaseError):
        raise error
    return () if error is None else error.problems


def _manifest_sha256(path: Path) -> str | None:
    try:
        return hashlib.sha256(manifest_bytes(path)).hexdigest()
    except (OSError, HeartcaseError):
        return None
