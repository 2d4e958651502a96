"""Guided tours in the studio: those of a case, and the session that is led through their steps."""
