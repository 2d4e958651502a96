"""A case bundle from the outputs of the stages: its figures and warnings, its files, and how they are written."""
