"""``python -m benchmarks NAME...``, in the repository: run the cases whose names start so."""

import sys

from benchmarks.runner.command import command
from heartcase.cli.main import main

if __name__ == "__main__":
    sys.exit(main(command=command, name="python -m benchmarks"))
