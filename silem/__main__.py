"""``python -m silem`` is the command line ``silem``."""

import sys

from silem.cli import main

if __name__ == "__main__":
    sys.exit(main())
