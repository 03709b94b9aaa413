"""``python -m hilbrace`` is the command line."""

import sys

from hilbrace.cli import main

sys.exit(main())
