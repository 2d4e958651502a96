"""``heartcase bench``: run the cases of a checkout's benchmarks/, and show time against error."""
