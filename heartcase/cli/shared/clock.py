"""How long a command takes for whoever waits, from its start on, and what is said where they wait no longer."""

from __future__ import annotations

import time

__all__ = ["INTERRUPTED", "command_seconds", "command_starts"]

INTERRUPTED = "nothing half-written was left, and the next build goes on from the stages that are finished"
"""What Ctrl-C during a build means."""

_started_s = time.perf_counter()


def command_starts() -> None:
    """Note that a command begins."""
    global _started_s  # one process runs one command; a test runs several in turn
    _started_s = time.perf_counter()


def command_seconds() -> float:
    """Seconds since it began."""
    return time.perf_counter() - _started_s
