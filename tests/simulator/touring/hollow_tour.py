"""A tour of the hollow case: it looks, passes a probe through the hole, opens the lid, sews a patch on, and closes."""

TOUR = """\
+++
heartcase_tour = 1
case = "hollow"
+++

# Two rooms

A box with **two rooms** and a hole between them.

## From outside

Nothing is to be seen.

```toml
[view]
from = "front"
```

## The hole

Look at it.

```toml
[view]
at = "hole"
from = "above"
square = true
width_mm = 30

[cut_plane]
through = { near = "hole", towards = "above", by_mm = 6 }
removes = "above"
```

### How many corners has it?

- [ ] Three

  One is missing.
- [x] Four

  It is a *square*.

## Through it

A probe goes through.

```toml
[view]
at = "hole"
from = "above front"

[[do]]
kind = "pass_through"
landmark = "hole"
side = "lid"
radius_mm = 2
from_mm = 6
to_mm = 4
seconds = 0.1
```

## Open

The lid is cut and held open.

```toml
[view]
at = "lid"
square = true

[[do]]
kind = "withdraw_probe"
name = "probe"

[[do]]
kind = "open_along"
landmark = "lid"
hands_per_lip = 1
seconds = 0.1
```

## Close the hole

A patch.

```toml
[[do]]
kind = "patch_over"
landmark = "hole"
side = "lid"
spacing_mm = 4
seconds = 0.05
```

## Close the lid

A thread.

```toml
[[do]]
kind = "close_along"
landmark = "lid"
spacing_mm = 5
seconds = 0.1
```
"""
