"""The synthetic heart itself: its shapes, and the true label and signed distance of every point."""
