"""``python -m airtact`` runs the command line."""

import sys

from airtact.cli import main

if __name__ == "__main__":
    sys.exit(main())
