"""A case that moves in the page: a live session, the pages that look at it, and what both say to each other."""
