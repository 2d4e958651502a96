"""What takes steps: one interface, and an engine for each backend."""
