"""What a hand holds: grabs and probes."""
