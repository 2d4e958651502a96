"""Surface and sheets divided by one another: what crosses is decided on whole numbers, and so is the order of it."""
