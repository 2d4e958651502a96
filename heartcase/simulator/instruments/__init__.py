"""What a hand holds: grabs, probes, forceps, retractors and scissors."""
