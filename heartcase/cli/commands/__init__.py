"""One module for each command that is not a stage, named like the command."""
