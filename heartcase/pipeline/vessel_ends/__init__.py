"""Where vessels end: ends found from the labels, moved onto their vessel, and cut open."""
