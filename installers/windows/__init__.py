"""A zip for Windows that starts the studio by a double click, without administrator rights."""
