"""Commands that run a simulation: scripted, recorded, repeated."""
