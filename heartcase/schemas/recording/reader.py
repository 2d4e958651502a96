"""Opening a recording: the header, the whole log, and where its states lie; a state is read when it is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from heartcase.schemas.arguments import whole_number
from heartcase.schemas.errors import Problem, RecordingError
from heartcase.schemas.files import is_there
from heartcase.schemas.recording.commands import Entry, Mark
from heartcase.schemas.recording.header import LOG_NAME, RecordingHeader, RecordingParent, header_hash, read_header
from heartcase.schemas.recording.log import LINE_SIZE_MAX, History, StateLine, opened

__all__ = ["Recording", "check_recording", "is_recording", "open_recording"]


@dataclass(frozen=True)
class Recording:
    """A recording that was opened."""

    directory: Path
    """Its folder, ``NAME.recording``."""
    header: RecordingHeader
    """Of which case it is, and how its simulation was set."""
    entries: tuple[Entry, ...]
    """What was done, in order, with step numbers; what was taken back for good is left out."""
    position: int
    """How many of the entries were done at the end."""
    states: dict[int, StateLine]
    """Stored states, by the number of entries that were done by then."""
    log_hash: str
    """Link of the last line that was read: it stands for header and log."""
    is_whole: bool
    """Whether it was finished, and nothing of it is missing."""

    @property
    def partial_warning(self) -> Problem | None:
        """What is said where it is shown, of one that is not whole."""
        words = f"it is not whole: the first {self.seconds:.1f} s are shown"
        return None if self.is_whole else Problem(self.directory.stem, words)

    @property
    def start_step(self) -> int:
        """Step at which it begins."""
        return self.header.start_step

    @property
    def end_step(self) -> int:
        """Step at which it ends."""
        return self.entries[self.position - 1].end_step if self.position else self.start_step

    @property
    def seconds(self) -> float:
        """Simulated time that it lasts, s."""
        return (self.end_step - self.start_step) * self.header.step_s

    @property
    def marks(self) -> tuple[tuple[str, int], ...]:
        """Named moments: name and step."""
        done = self.entries[: self.position]
        return tuple((entry.command.name, entry.step) for entry in done if isinstance(entry.command, Mark))

    def branch_at(self, step: int) -> RecordingParent:
        """What a recording that takes over at a step says of this one.

        Raises
        ------
        RecordingError
            The recording has no such step.
        """
        limits = {"least": self.start_step, "most": self.end_step}
        step = whole_number(step, "step", **limits, error=RecordingError)
        return RecordingParent(log_hash=self.log_hash, step=step)

    def state_bytes(self, position: int) -> bytes:
        """The file of a stored state.

        Raises
        ------
        RecordingError
            None was stored there, or it is missing or damaged.
        """
        if position not in self.states:
            there = ", ".join(map(str, self.states)) or "none"
            message = f"no state is stored where {position!r} entries are done; there are: {there}"
            raise RecordingError(message, place="position")
        said = self.states[position]
        file = self.directory / said.file
        try:
            content = b"" if file.is_symlink() or file.stat().st_size != said.size else file.read_bytes()
        except OSError:
            content = b""
        if sha256(content).hexdigest() != said.sha256:
            raise RecordingError(
                f"the state of step {said.step} is damaged: it is not what was recorded", place=said.file
            )
        return content


def is_recording(path: Path) -> bool:
    """Whether there is a folder at the path with the ending of recordings, or with a log in it."""
    return is_there(path) and path.is_dir() and (path.suffix == ".recording" or (path / LOG_NAME).is_file())


def open_recording(path: Path | str, *, partial: bool = False) -> Recording:
    """Open a recording: every line of its log is checked, and the sizes of its states.

    Parameters
    ----------
    path
        Its folder, ``NAME.recording``.
    partial
        Of one that was cut short or damaged, take what is whole at its beginning, instead of refusing it.

    Raises
    ------
    RecordingError
        It is no recording, of a newer version, cut short, or damaged.
    """
    directory = Path(path)
    header = read_header(directory)
    history = History(header.start_step)
    link, count, trouble = header_hash(header), 0, None
    for content in _lines(directory):
        try:
            line, own = opened(content.removesuffix(b"\n"), link) if content.endswith(b"\n") else _refuse_torn()
            history.take(line)
        except ValueError as error:
            trouble = str(error)
            break
        if isinstance(line, StateLine) and (found := _state_problem(directory, line)):
            if not partial:
                raise RecordingError(found)
            del history.states[history.position]
        link, count = own, count + 1
    end = header.end
    is_whole = trouble is None and end is not None and (end.line_count, end.log_hash) == (count, link)
    if not is_whole and not partial:
        raise RecordingError(_what_is_missing(header, history, count, trouble), place=LOG_NAME)
    return Recording(
        directory, header, tuple(history.entries), history.position, history.states, link, is_whole=is_whole
    )


def check_recording(path: Path | str) -> list[Problem]:
    """Everything that is wrong with a recording, the hash of every state included."""
    try:
        recording = open_recording(path)
    except RecordingError as error:
        return list(error.problems)
    problems: list[Problem] = []
    for position in recording.states:
        try:
            recording.state_bytes(position)
        except RecordingError as error:
            problems += error.problems
    return problems


def _lines(directory: Path) -> Iterator[bytes]:
    """Lines of the log with their breaks; the last may have none."""
    file = directory / LOG_NAME
    if file.is_symlink() or not file.is_file():
        return
    try:
        with file.open("rb") as stream:
            while line := stream.readline(LINE_SIZE_MAX):
                yield line
    except OSError:
        raise RecordingError("cannot be read", place=LOG_NAME) from None


def _refuse_torn() -> tuple[StateLine, str]:
    raise ValueError(_TORN)


_TORN = "it ends in the middle"


def _state_problem(directory: Path, line: StateLine) -> Problem | None:
    file = directory / line.file
    if file.is_symlink() or not file.is_file():
        return Problem(line.file, f"the state of step {line.step} is missing: the recording is damaged")
    if file.stat().st_size != line.size:
        return Problem(line.file, f"the state of step {line.step} is damaged: it is not what was recorded")
    return None


def _what_is_missing(header: RecordingHeader, history: History, count: int, trouble: str | None) -> str:
    """Why a recording is not whole, and what can be had of it."""
    so_far = f"{(history.step - header.start_step) * header.step_s:.3f} s can be had with partial"
    if trouble == _TORN or trouble is None:
        if header.end is None:
            return f"the recording was cut short, as when the program that recorded it was killed: its first {so_far}"
        if trouble == _TORN or count < header.end.line_count:
            return f"the recording was cut short after it was finished: its first {so_far}"
        return f"the log is not the one that the header ends with: its first {so_far}"
    return f"line {count + 1} is damaged ({trouble}): the first {so_far}"
