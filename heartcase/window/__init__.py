"""The window in which a case is operated on with the mouse: a client of an operating session."""
