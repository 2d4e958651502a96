"""The edit stage: what each kind of edit does."""
