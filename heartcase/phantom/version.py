"""The version of the phantom, for those who only want to know whether a scan is still the one it would make."""

__all__ = ["PHANTOM_VERSION"]

PHANTOM_VERSION = 1
"""Raised when the same settings give another scan."""
