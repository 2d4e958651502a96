"""One file per format: what reads scans, label volumes and point lists."""
