"""What is found out about a model that may differ from the patient: openings, leaks, narrowed lumens, cut faces."""
