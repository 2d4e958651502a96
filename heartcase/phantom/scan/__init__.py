"""From the synthetic heart to a scan: signal, noise and artefacts of MRI and CT."""
