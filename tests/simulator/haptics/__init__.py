"""The servo loop and its devices."""
