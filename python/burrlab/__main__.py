"""`python -m burrlab` is the command line."""

import sys

from burrlab.cli import main

if __name__ == "__main__":
    sys.exit(main())
