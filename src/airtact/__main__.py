"""Run the command line as ``python -m airtact``."""

import sys

from airtact.cli import main

if __name__ == "__main__":
    sys.exit(main())
