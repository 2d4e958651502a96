"""heartcase: from a cardiac MRI or CT to a case bundle and a real-time simulation of it."""

__version__ = "0.1.0"
