"""From scan to case: one file per stage, arrays in, dataclass out."""
