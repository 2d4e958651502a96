"""The case saved as one HTML file that needs no server, with some of its recordings, by a process beside."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import Problem
from heartcase.schemas.files import atomic_write
from heartcase.studio.message_words import problem_facts
from heartcase.studio.messages import told
from heartcase.studio.operating.beside import Beside
from heartcase.studio.operating.ending import problems_at

__all__ = ["PageOf", "SavedPage", "told_seldom"]

PageOf = Callable[[Path, Sequence[Path], Callable[[float], None]], tuple[bytes, list[Problem]]]
"""Makes the file of a case and its recordings, and says what is wrong with it; a process beside must find it. It tells
which part is done, 0 to 1."""

_LEAST = 0.01
"""By how much more must be done before it is told again."""
_ENDED = "what saves the page has ended: save it again"


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
        self._saved: dict[str, Any] = {}
        self._beside = Beside("page")
        self.file: Path | None = None
        """The file that was saved last."""

    def save(self, names: Sequence[str]) -> None:
        """Save the case with these recordings; what was being saved is left."""
        self.close()
        path = self._free_name()
        refuse_inside_case(path, place="page")
        recordings = [self._out / name for name in dict.fromkeys(names)]
        # told before the process can answer
        self._tell(state="working")
        self._beside.start(_make, self._page_of, self._case, recordings, talk=lambda line: self._wait(line, path))

    def close(self) -> None:
        """Leave what is being saved."""
        self._beside.end()
        if self._facts.get("state") == "working":
            self._facts = self._saved

    def leave(self) -> None:
        """Leave what is being saved, and tell the pages; what was saved before is still to be had."""
        self.close()
        self._heard()

    @property
    def facts(self) -> dict[str, Any]:
        """What pages are told: nothing where no page was saved; else its state, what is done, name, size, problems."""
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
        content, problems = b"", [problem_facts("page", _ENDED)]
        with contextlib.suppress(EOFError, OSError):
            while isinstance(said := line.recv(), float):
                if not self._beside.is_left:
                    self._tell(state="working", fraction=said)
            content, problems = said
        if self._beside.is_left:
            return
        if content:
            # by this process: the one beside may be killed at any moment, and leaves nothing behind
            try:
                atomic_write(path, content)
                self.file = path
            except OSError as error:
                words = f"it cannot be written: {error.strerror or 'no reason given'}"
                content, problems = b"", [problem_facts("page", words)]
        state = "saved" if content else "failed"
        folder = {"folder": str(path.parent)} if content else {}
        self._tell(state=state, name=path.name, byte_count=len(content), problems=problems, **folder)

    def _tell(self, **facts: Any) -> None:
        self._facts = facts
        if facts["state"] == "saved":
            self._saved = facts
        self._heard()


def told_seldom(tell: Callable[[float], None]) -> Callable[[float], None]:
    """What passes a part that is done on, where it is a hundredth more than was told before."""
    last = 0.0

    def heard(part: float) -> None:
        nonlocal last
        if part >= last + _LEAST:
            last = part
            tell(float(part))

    return heard


def _make(line: Connection, page_of: PageOf, case: Path, recordings: list[Path]) -> None:
    """The process: answer with the file's content, nothing where it cannot be made, and what is wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        try:
            content, warnings = page_of(case, recordings, told_seldom(line.send))
            line.send((content, [problem_facts(one.place, one.message) for one in warnings]))
        except Exception as error:
            line.send((b"", problems_at(case, told(error))))
