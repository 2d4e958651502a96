"""From scan to case: arrays in, dataclasses out; ``stages`` has the order."""
