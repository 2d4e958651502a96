"""``python -m heartcase`` is the same as ``heartcase``."""

import sys

from heartcase.cli.main import main

sys.exit(main())
