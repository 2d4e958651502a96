"""What works in the background of a live session: figures of incisions, and a haptic device that leads a hand."""
