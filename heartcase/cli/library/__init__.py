"""``heartcase library``: build, check, compare and show many cases."""
