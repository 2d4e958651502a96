"""The catalogue of a library: a website of plain files that opens from a folder, without a server."""
