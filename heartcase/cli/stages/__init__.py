"""One module for each stage command: one stage of a build by itself, from files to a file."""
