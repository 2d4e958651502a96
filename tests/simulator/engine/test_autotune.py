"""The quicker of two ways is found, and found again when it changes."""

from __future__ import annotations

import pytest

from heartcase.simulator.engine.cpu.autotune import ROUND_STEPS, ROUNDS_BETWEEN_TRIALS, TRIAL_STEPS, TRIALS, Autotuner


class Workshop:
    """Two ways with a made-up time per step."""

    def __init__(self, *seconds_per_step: float) -> None:
        self.seconds_per_step = list(seconds_per_step)
        self.taken = [0] * len(seconds_per_step)
        self.now = 0.0
        self.autotuner = Autotuner(clock=lambda: self.now)

    def run(self, step_count: int) -> None:
        self.autotuner.run(step_count, tuple(self.way(number) for number in range(len(self.taken))))

    def way(self, number: int):
        def take(count: int) -> None:
            self.taken[number] += count
            self.now += count * self.seconds_per_step[number]

        return take


def test_quicker_way_takes_nearly_all_steps():
    for quick in (0, 1):
        shop = Workshop(*(1.0 if number == quick else 9.0 for number in (0, 1)))
        for _ in range(ROUNDS_BETWEEN_TRIALS):
            shop.run(100)
        assert sum(shop.taken) == 100 * ROUNDS_BETWEEN_TRIALS
        assert shop.taken[1 - quick] <= TRIALS * TRIAL_STEPS


def test_change_is_noticed():
    shop = Workshop(1.0, 5.0)
    shop.run(100)
    assert shop.autotuner.quickest == 0
    shop.seconds_per_step = [5.0, 1.0]
    for _ in range(ROUNDS_BETWEEN_TRIALS + 1):
        shop.run(100)
    assert shop.autotuner.quickest == 1


def test_a_wrong_choice_does_not_last_in_long_rows():
    """Another program had the cores when the ways were tried."""
    shop = Workshop(1.0, 3.0)
    shop.run(2 * TRIALS * TRIAL_STEPS)
    shop.seconds_per_step = [1.0, 0.5]
    shop.run(1000)
    assert shop.taken[1] >= 1000 - 2 * ROUND_STEPS


def test_few_steps_are_taken_once():
    shop = Workshop(1.0, 1.0)
    for count in (1, TRIAL_STEPS, 0, 2 * TRIAL_STEPS + 1):
        shop.run(count)
    assert sum(shop.taken) == 3 * TRIAL_STEPS + 2


@pytest.mark.parametrize("step_count", [1, TRIAL_STEPS, TRIAL_STEPS + 1, 17, 20, 23])
def test_a_way_is_tried_to_the_end_also_where_the_first_rows_are_short(step_count):
    """Waking the threads takes longer than the steps; a row is too short for all trials of both ways."""
    shop = Workshop(2.0, 1.0)
    undisturbed = shop.way

    def way(number: int):
        def take(count: int) -> None:
            if number == 1 and count and shop.taken[1] == 0:
                shop.now += 1000.0
            undisturbed(number)(count)

        return take

    shop.way = way
    for _ in range(2 * TRIALS):
        shop.run(step_count)
    assert shop.autotuner.quickest == 1
    assert sum(shop.taken) == 2 * TRIALS * step_count


@pytest.mark.parametrize("disturbed", [1, 2])
def test_a_slow_start_or_trial_is_not_held_against_a_way(disturbed):
    """Threads have to be woken, and once the machine does something else."""
    shop = Workshop(2.0, 1.0)
    undisturbed, steps_before = shop.way, TRIAL_STEPS * disturbed

    def way(number: int):
        def take(count: int) -> None:
            if number == 1 and count and shop.taken[1] in (0, steps_before):
                shop.now += 1000.0
            undisturbed(number)(count)

        return take

    shop.way = way
    shop.run(100)
    assert shop.autotuner.quickest == 1


@pytest.mark.parametrize("step_count", [40, 146])
def test_a_way_that_was_disturbed_while_it_was_in_use_is_taken_again_soon(step_count):
    shop = Workshop(2.0, 1.0)
    for _ in range(5):
        shop.run(step_count)
    undisturbed = shop.way

    def way(number: int):
        def take(count: int) -> None:
            shop.now += 1000.0 if number == 1 else 0.0
            undisturbed(number)(count)

        return take

    shop.way = way
    shop.run(step_count)
    assert shop.autotuner.quickest == 0
    shop.way, before = undisturbed, shop.taken[0]
    for _ in range(3):
        shop.run(step_count)
    assert shop.autotuner.quickest == 1
    assert shop.taken[0] - before <= 2 * step_count


def test_a_row_of_few_steps_says_nothing_of_the_way_in_use():
    """An act between two frames leaves a row of a step or two, which mostly wakes the threads."""
    shop = Workshop(2.0, 1.0)
    for _ in range(5):
        shop.run(100)
    shop.seconds_per_step[1] = 100.0
    shop.run(TRIAL_STEPS - 1)
    shop.seconds_per_step[1] = 1.0
    before = shop.taken[0]
    for _ in range(5):
        shop.run(100)
    # it is tried now and then
    assert shop.taken[0] - before <= TRIALS * TRIAL_STEPS
