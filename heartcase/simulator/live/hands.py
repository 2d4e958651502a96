"""What a user has in hand on a live session: the tools, and the one that is in use. Pointers in, commands out."""

from __future__ import annotations

from heartcase.schemas.recording.commands import Redo, Rewind, TieStitch, Undo
from heartcase.simulator.live.letting_go import letting_go, removable
from heartcase.simulator.live.live import Live
from heartcase.simulator.live.rays import Pointer
from heartcase.simulator.live.tool import Tool, nearest_held
from heartcase.simulator.live.tools import TOOLS

__all__ = ["REWIND_S", "Hands"]

REWIND_S = 1.0
"""How far one goes back at a time, simulated s."""


class Hands:
    """The tools of one user, and which of them is in hand.

    Parameters
    ----------
    live
        The session: what comes of tools is asked of it.
    """

    def __init__(self, live: Live) -> None:
        self.live = live
        self.tools: dict[str, Tool] = {tool.key: tool(self.new_name) for tool in TOOLS}
        self.tool: Tool | None = None
        self.is_used = False
        self._named: dict[str, int] = {}

    @property
    def needs_hit(self) -> bool:
        """Whether it matters what of the tissue is pointed at: not while something is led."""
        return self.tool is None or self.tool.led is None

    def take(self, key: str, pointer: Pointer | None = None) -> None:
        """Take a tool by its key, none with an empty one; what was begun is put down.

        Parameters
        ----------
        key
            Key of the tool.
        pointer
            Where the mouse points to; None where that is not known.
        """
        self.put_down(pointer)
        self.tool = self.tools.get(key)

    def press(self, pointer: Pointer) -> bool:
        """Use the tool there; whether there was a use for it."""
        held = self.live.newest.held
        if self.tool is None:
            return False
        if pointer.hit is None and not self.tool.is_waiting and nearest_held(pointer, held) is None:
            return False
        self.is_used = True
        self.live.do(*self.tool.press(pointer, held))
        return True

    def drag(self, pointer: Pointer) -> bool:
        """Go on using it; whether one is in use."""
        if not self.is_used or self.tool is None:
            return False
        self.live.do(*self.tool.drag(pointer))
        return True

    def release(self, pointer: Pointer) -> bool:
        """End its use; whether one was in use."""
        if not self.is_used or self.tool is None:
            return False
        self.is_used = False
        self.live.do(*self.tool.release(pointer))
        return True

    def wheel(self, notches: int) -> bool:
        """Turn the wheel away from the user by notches; whether the tool in use had a use for it."""
        given = self.tool.wheel(notches) if self.tool is not None and self.is_used else None
        if given is None:
            return False
        self.live.do(*given)
        return True

    def resize(self, steps: int) -> None:
        """Change what can be set of the tool in hand, by steps."""
        if self.tool is not None:
            self.tool.resize(steps)

    def put_down(self, pointer: Pointer | None = None) -> None:
        """Forget what was begun. What the mouse leads lets go as if it was released."""
        if pointer is not None:
            self.release(pointer)
        self.forget()

    def forget(self) -> None:
        """Forget what was begun: time goes elsewhere, and what the mouse leads may not be there then."""
        self.is_used = False
        for tool in self.tools.values():
            tool.forget()

    def abandon(self) -> None:
        """The user is gone: what is led stays where it is, and then lets go softly; a line that is drawn is forgotten.

        What stays by itself, such as forceps, is left where it is.
        """
        tool, led = self.tool, None if self.tool is None else self.tool.led
        if led is not None and tool is not None and tool.lets_go:
            self.live.let_go_softly(led)
        self.forget()

    def let_go(self, pointer: Pointer | None = None) -> bool:
        """Let go or take out what is pointed at, else the instrument that holds since last; whether there was any."""
        there = [] if pointer is None else removable(self.live.newest, pointer.plane)
        pointed = None if pointer is None else nearest_held(pointer, there)
        command = letting_go(self.live.newest, None if pointed is None else pointed.name)
        if command is None:
            return False
        self.live.do(command)
        return True

    def let_go_of_all(self) -> bool:
        """Let every instrument go, or take it away, at one moment: one undo brings all back; whether there was any."""
        newest = self.live.newest
        commands = [letting_go(newest, name) for name in newest.frame.instruments]
        self.live.do(*(one for one in commands if one is not None))
        return bool(commands)

    def tie(self) -> None:
        """Tie all stitches that are drawn; a row as one, whose name stands for all of it."""
        stitches = self.live.newest.frame.stitches.values()
        loose = dict.fromkeys(stitch.row or stitch.name for stitch in stitches if not stitch.is_tied)
        self.live.do(*(TieStitch(name=name) for name in loose))

    def undo(self) -> None:
        """Take the last act back."""
        self.forget()
        self.live.do(Undo())

    def redo(self) -> None:
        """Do again what was taken back."""
        self.forget()
        self.live.do(Redo())

    def take_up(self, branch: int) -> None:
        """Go back to where a branch begins, as :meth:`heartcase.simulator.live.live.Live.take_up` does."""
        self.forget()
        self.live.take_up(branch)

    def rewind(self) -> None:
        """Go back a little."""
        self.forget()
        self.live.do(Rewind(seconds=REWIND_S))

    def play(self, speed: float = 1.0, *, skips: bool = False) -> None:
        """Do again what is known from here on, as :meth:`heartcase.simulator.live.live.Live.play` does."""
        self.forget()
        self.live.play(speed, skips=skips)

    def new_name(self, kind: str) -> str:
        """A name that no instrument, stitch, row or patch has yet."""
        newest = self.live.newest.frame
        rows = {stitch.row for stitch in newest.stitches.values()}
        there = {*newest.instruments, *newest.stitches, *newest.patches, *rows}
        number = self._named.get(kind, 0) + 1
        while f"{kind} {number}" in there:
            number += 1
        self._named[kind] = number
        return f"{kind} {number}"
