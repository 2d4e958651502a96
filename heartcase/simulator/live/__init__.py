"""A session that runs in a thread of its own, and what a pointer on the tissue makes of it: for window and page."""
