"""Sutures and patches: places in tissue, threads between them, rows of these, and sheets that are sewn on."""
