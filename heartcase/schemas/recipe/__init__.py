"""The recipe of a case: its file, the settings of every stage, edits, and locks."""
