"""The case saved as one HTML file that needs no server, with some of its recordings, by a process beside."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.files import atomic_write
from heartcase.schemas.recording.reader import open_recording
from heartcase.simulator.session.replay import FRAMES_MAX
from heartcase.studio.messages import told
from heartcase.studio.offline.exported import page_of
from heartcase.studio.offline.web_page import FRAMES_PER_SECOND
from heartcase.studio.operating.ending import problems_at

__all__ = ["SavedPage"]

_ENDED = "what saves the page has ended: save it again"
_NICE = 10
_END_S = 2.0


class SavedPage:
    """What is known of the page that is being saved, or was saved last.

    Parameters
    ----------
    case
        The case's folder.
    out
        Folder of its recordings; the page is put there too.
    heard
        Called by a thread when there is something new.
    """

    def __init__(self, case: Path, out: Path, heard: Callable[[], None]) -> None:
        self._case, self._out, self._heard = case, out, heard
        self._facts: dict[str, Any] = {}
        self._process: Any = None
        self._thread: threading.Thread | None = None
        self.file: Path | None = None
        """The file that was saved last."""

    def save(self, names: Sequence[str]) -> None:
        """Save the case with these recordings; what was being saved is left."""
        self.close()
        context = multiprocessing.get_context("spawn")
        line, its_line = context.Pipe()
        path = self._free_name()
        recordings = [str(self._out / name) for name in dict.fromkeys(names)]
        self._process = context.Process(
            target=_save, args=(its_line, str(self._case), recordings, str(path)), daemon=True, name="heartcase-page"
        )
        self._process.start()
        its_line.close()
        self._tell(state="working")
        self._thread = threading.Thread(target=self._wait, args=(line, path), name="saved page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave what is being saved."""
        process, thread, self._process, self._thread = self._process, self._thread, None, None
        if process is not None:
            process.terminate()
            process.join(_END_S)
        if thread is not None:
            thread.join()
        if self._facts.get("state") == "working":
            self._facts = {}

    @property
    def facts(self) -> dict[str, Any]:
        """What pages are told: nothing where no page was saved; else its ``state``, name, size and problems."""
        return dict(self._facts)

    def _free_name(self) -> Path:
        """A name that no file has."""
        stem, number = self._case.name.removesuffix(".case"), 1
        path = self._out / f"{stem}.html"
        while path.exists():
            number += 1
            path = self._out / f"{stem}-{number}.html"
        return path

    def _wait(self, line: Connection, path: Path) -> None:
        problems: list[dict[str, str]] = [asdict(Problem("page", _ENDED))]
        size = 0
        with contextlib.suppress(EOFError, OSError):
            size, problems = line.recv()
        line.close()
        if self._thread is not threading.current_thread():
            return
        if size:
            self.file = path
        state = "saved" if size else "failed"
        self._tell(state=state, name=path.name, byte_count=size, problems=problems)

    def _tell(self, **facts: Any) -> None:
        self._facts = facts
        self._heard()


def _save(line: Connection, case: str, recordings: list[str], path: str) -> None:
    """The process: write the file, and answer with its size in bytes, 0 where there is none, and what is wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        with contextlib.suppress(OSError):
            os.nice(_NICE)
    with contextlib.suppress(OSError):
        try:
            found = [Path(one) for one in recordings]
            longest = max((open_recording(one).seconds for one in found), default=0.0)
            rate = min(FRAMES_PER_SECOND, (FRAMES_MAX - 2) / max(longest, 1.0))
            content, warnings = page_of(Path(case), found, level=0, frames_per_second=rate)
            atomic_write(Path(path), content)
            line.send((len(content), [{"place": "", "message": warning} for warning in warnings]))
        except OSError as error:
            problem = Problem("page", f"it cannot be written: {error.strerror or 'no reason given'}")
            line.send((0, problems_at(Path(case), HeartcaseError([problem]))))
        except Exception as error:
            line.send((0, problems_at(Path(case), told(error))))
