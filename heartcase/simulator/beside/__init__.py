"""What works beside a live session: figures of incisions, and a haptic device that leads a hand in it."""
