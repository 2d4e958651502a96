"""Write a small case: ``python -m tests.write_block_case DIRECTORY``."""

import sys

from heartcase.pipeline.bundle.write_bundle import write_bundle
from tests.factories import block_case

if __name__ == "__main__":
    write_bundle(sys.argv[1], block_case(size=(6, 4, 4)))
