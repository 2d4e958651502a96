"""Autotuning: choosing, while it runs, the quicker of two ways to do the same work.

Threads that wait for one another after every step are quickest on an idle machine and slowest on a busy one, where
each waits for the other thread's turn. What is quicker is therefore measured as the work goes on. It may be: both ways
give the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf

__all__ = ["Autotuner"]

TRIAL_STEPS = 4
"""Steps of a trial of the way that is not in use."""
TRIALS = 3
"""Trials one after the other."""
ROUNDS_BETWEEN_TRIALS = 32
"""How often the way that is not in use gets a trial; where it is in doubt, at first twice as long after each."""
DOUBTFUL_RATIO = 4.0
"""A way that took up to so many times as long as the quickest may only have been disturbed: it is tried again soon."""
ROUND_STEPS = 256
"""Steps after which a new round begins, where a call does not end before."""


Work = Callable[[int], None]
"""Takes a number of steps in one way."""


@dataclass
class Autotuner:
    """Remembers how long a step takes in each way."""

    clock: Callable[[], float] = time.perf_counter
    """Time in s."""
    seconds_per_step: list[float] = field(default_factory=list)
    """Lately, per way; infinite before it has been tried, empty before the first run."""
    round_count: int = 0
    """Rounds so far."""
    trials: dict[int, list[float]] = field(default_factory=dict)
    """Seconds per step of trials, by the way that is being tried; a short round leaves some to the next."""

    def run(self, step_count: int, ways: tuple[Work, ...]) -> None:
        """Take steps, most of them in the way that has been quickest lately.

        Parameters
        ----------
        step_count
            Steps to take in all.
        ways
            The ways, always in the same order; each is called with its share of the steps.
        """
        if not self.seconds_per_step:
            for way in ways:
                way(0)
            self.seconds_per_step = [inf] * len(ways)
            self.trials = {number: [] for number in range(len(ways))}
        while step_count:
            round_steps = min(step_count, ROUND_STEPS)
            self._run_round(round_steps, ways)
            step_count -= round_steps

    def _run_round(self, step_count: int, ways: tuple[Work, ...]) -> None:
        is_regular = self.round_count % ROUNDS_BETWEEN_TRIALS == 0
        is_early = self.round_count.bit_count() == 1
        for number in range(len(ways)):
            is_doubtful = self.seconds_per_step[number] <= DOUBTFUL_RATIO * min(self.seconds_per_step)
            if number != self.quickest and (is_regular or (is_early and is_doubtful)):
                self.trials.setdefault(number, [])
        for number, trials in list(self.trials.items()):
            while len(trials) < TRIALS and step_count:
                trial_steps = min(TRIAL_STEPS, step_count)
                trials.append(self._take(trial_steps, ways[number]))
                step_count -= trial_steps
            if len(trials) == TRIALS:
                # The first steps in a way wake its threads; of those after them, the least disturbed count.
                self.seconds_per_step[number] = min(trials[1:])
                del self.trials[number]
        if step_count:
            number = self.quickest
            taken = self._take(step_count, ways[number])
            # As long as a way has not been tried to the end it has no time of its own; few steps mostly wake threads.
            if self.seconds_per_step[number] < inf and step_count >= TRIAL_STEPS:
                self.seconds_per_step[number] = taken
            if self.quickest != number:
                # It may only have been disturbed: it is tried again with the next round.
                self.trials.setdefault(number, [])
        self.round_count += 1

    @property
    def quickest(self) -> int:
        """The way that has taken least time per step lately."""
        return self.seconds_per_step.index(min(self.seconds_per_step))

    def _take(self, step_count: int, way: Work) -> float:
        """Take steps in one way; returns what a step took, s."""
        started = self.clock()
        way(step_count)
        return (self.clock() - started) / step_count
