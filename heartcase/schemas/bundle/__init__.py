"""The case bundle: its format, reading it, checking it, and its approval."""
