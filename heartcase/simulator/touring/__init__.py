"""A guided tour on a case: what its steps show and do there, in numbers."""
