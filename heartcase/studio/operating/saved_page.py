"""The case saved as one HTML file that needs no server, with some of its recordings, by a process beside."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from heartcase.schemas.errors import HeartcaseError, Problem
from heartcase.schemas.files import atomic_write
from heartcase.studio.messages import told
from heartcase.studio.operating.ending import problems_at

__all__ = ["PageOf", "SavedPage"]

PageOf = Callable[[Path, Sequence[Path]], tuple[bytes, list[str]]]
"""Makes the file of a case and its recordings, and says what is wrong with it; a process beside must find it."""

_ENDED = "what saves the page has ended: save it again"
_END_S = 2.0


class SavedPage:
    """What is known of the page that is being saved, or was saved last.

    Parameters
    ----------
    case
        The case's folder.
    out
        Folder of its recordings; the page is put there too.
    page_of
        Makes the file.
    heard
        Called by a thread when there is something new.
    """

    def __init__(self, case: Path, out: Path, page_of: PageOf, heard: Callable[[], None]) -> None:
        self._case, self._out, self._page_of, self._heard = case, out, page_of, heard
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
        recordings = [self._out / name for name in dict.fromkeys(names)]
        order = (its_line, self._page_of, self._case, recordings, path)
        self._process = context.Process(target=_save, args=order, daemon=True, name="heartcase-page")
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


def _save(line: Connection, page_of: PageOf, case: Path, recordings: list[Path], path: Path) -> None:
    """The process: write the file, and answer with its size in bytes, 0 where there is none, and what is wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        try:
            content, warnings = page_of(case, recordings)
            atomic_write(path, content)
            line.send((len(content), [{"place": "", "message": warning} for warning in warnings]))
        except OSError as error:
            problem = Problem("page", f"it cannot be written: {error.strerror or 'no reason given'}")
            line.send((0, problems_at(case, HeartcaseError([problem]))))
        except Exception as error:
            line.send((0, problems_at(case, told(error))))
