"""Allow ``python -m vibraverse``."""

import sys

from vibraverse.cli import main

sys.exit(main())
