"""Building in the page: a process that builds, what it tells, what came of it, and its approval."""
