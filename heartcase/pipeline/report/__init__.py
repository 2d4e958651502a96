"""The build report and its pictures."""
