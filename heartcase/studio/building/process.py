"""The process that builds, as the server sees it: news come out, and it can be ended at any moment."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import heartcase

__all__ = ["BuildProcess"]

_ROOT = Path(heartcase.__file__).parents[1]
_RUN = (
    "import runpy, sys; sys.path.append(sys.argv[1]); "
    "runpy.run_module('heartcase.studio.building.work', run_name='__main__')"
)
"""The package is found also where this process found it: in a checkout that is not installed."""
_LINE_LENGTH_MAX = 1 << 24
"""Bytes of a line at most: warnings may have many places."""


class BuildProcess:
    """A build in a process of its own.

    Parameters
    ----------
    recipe
        The recipe's file.
    out
        Directory that the case is built in, with the build's cache.
    """

    def __init__(self, recipe: Path, out: Path) -> None:
        self._order = {"recipe": str(recipe.resolve()), "out": str(out.resolve())}
        self._process: asyncio.subprocess.Process | None = None
        self._is_ended = False

    async def news(self) -> AsyncIterator[dict[str, Any]]:
        """Start it, and tell what it tells until it has ended."""
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            # modules that lie in the folder that the studio was started in are none of ours
            "-P",
            "-c",
            _RUN,
            str(_ROOT),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=None if os.environ.get("HEARTCASE_DEBUG") else asyncio.subprocess.DEVNULL,
            limit=_LINE_LENGTH_MAX,
            # Ctrl-C goes to a terminal's whole group: the server ends the build, and those who compile for it
            start_new_session=True,
        )
        self._process = process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            if self._is_ended:
                self.end()
            with contextlib.suppress(ConnectionError):
                # paths go where no list of processes shows them
                process.stdin.write(json.dumps(self._order).encode() + b"\n")
                await process.stdin.drain()
            while line := await process.stdout.readline():
                yield json.loads(line)
        finally:
            if process.returncode is None:
                self.end()
            await process.wait()

    def end(self) -> None:
        """End it at once, with the processes that it started."""
        self._is_ended = True
        process = self._process
        if process is None or process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            if os.name == "posix":
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
